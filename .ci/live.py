#!/usr/bin/env python3
"""Uses the page of `meldscope live` in headless Chromium as a person would.

    live.py MELDSCOPE         [PICTURE=F.png in the environment: keeps a picture of the page]

Moves a slider and checks the table of events, follows its links, types a wrong value, drags a slider through 100
positions, pins a run, saves the recording and replays it from the command line. Exit status 1 if anything is not as it
should be, or if the page asks any machine but this one for anything.
"""
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from urllib.parse import urlsplit

from playwright.sync_api import sync_playwright

FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--ignore-gpu-blocklist"]
SLIDER = 'input[type="range"][data-key="influence.merge_at"]'
MERGE = '#events tr[data-event="merge a~b"]:not(.gone)'
SET = """([selector, value]) => {
    const slider = document.querySelector(selector);
    slider.value = value;
    slider.dispatchEvent(new Event("input"));
}"""
# The viewer shows the last run, at the page's cursor.
FOLLOWS = """(() => {
    const { handle, shown } = viewer;
    if (!shown || !run || isSending || run.number < asked || shown.number !== run.number) return false;
    return handle.get_time_for_timeline(shown.recording, "step") === cursor;
})()"""


def until(page, condition, seconds):
    """Waits for a condition of the page; its content security policy forbids Playwright to poll inside it."""
    deadline = time.time() + seconds
    while not page.evaluate(condition):
        if time.time() > deadline:
            raise TimeoutError(f"not within {seconds} s: {condition}")
        time.sleep(0.02)


def merge_time(page):
    return float(page.locator(MERGE).get_attribute("data-time"))


def check(page, folder):
    page.wait_for_selector(MERGE, timeout=30_000)
    first = merge_time(page)
    until(page, FOLLOWS, 120)  # the viewer is 41 MB of wasm, drawn in software

    page.evaluate(SET, [SLIDER, "0.98"])
    until(page, f"document.querySelector('{MERGE}')?.dataset.time > {first + 0.1}", 30)
    assert "later" in page.locator(MERGE).inner_text(), page.locator(MERGE).inner_text()
    assert "merge_at = 0.98" in page.inner_text("#toml"), page.inner_text("#toml")
    until(page, FOLLOWS, 60)

    page.locator(MERGE).click()
    until(page, FOLLOWS, 60)
    assert page.evaluate("cursor") == int(page.locator(MERGE).get_attribute("data-step"))
    page.locator("#step-on").click()
    until(page, FOLLOWS, 60)
    page.locator("#pin").click()
    if os.environ.get("PICTURE"):
        time.sleep(10)  # the viewer draws in software
        page.screenshot(path=os.environ["PICTURE"])

    exact = page.locator(".parameter", has=page.locator(SLIDER)).locator('input[type="text"]')
    exact.fill("1.3")
    exact.press("Enter")
    until(page, "document.querySelector('#message').textContent.includes('split_at')", 30)
    assert page.locator(MERGE).count() == 1, "the last good run is gone"
    exact.fill("0.99")
    exact.press("Enter")
    until(page, "document.querySelector('#message').textContent === ''", 30)

    for k in range(100):
        page.evaluate(SET, [SLIDER, str(0.97 + 0.002 * k)])
        time.sleep(0.02)
    start = time.time()
    until(page, FOLLOWS, 60)
    drag = time.time() - start
    last = page.evaluate("run.levels.find(level => level.label.startsWith('merge')).lines[0][1]")
    assert abs(last - (0.97 + 0.002 * 99)) < 1e-9, last

    page.evaluate(f"seek({int(page.locator(MERGE).get_attribute('data-step')) + 20})")
    page.locator("#branch").click()
    split = 'input[type="range"][data-key="influence.split_at"]'
    page.evaluate(SET, [split, "1.18"])
    until(page, "document.querySelector('#toml').textContent.includes('[[edit]]') && run.levels.length > 0", 30)
    page.locator("#branch").click()
    # a branch before another leaves it as it is
    page.evaluate("seek(cursor - 30)")
    page.locator("#branch").click()
    page.evaluate(SET, [split, "1.17"])
    edits = "[...document.querySelector('#toml').textContent.matchAll(/split_at\" = 1.1[0-9]*/g)].map(String).join()"
    until(page, f"{edits} === 'split_at\" = 1.17,split_at\" = 1.18'", 30)
    page.locator("#branch").click()
    page.locator('details[data-group="poke"] summary').click()
    page.locator("#poke").click()
    until(page, "document.querySelector('#toml').textContent.includes('[[point]]')", 30)
    until(page, FOLLOWS, 60)
    assert page.inner_text("#message") == "", page.inner_text("#message")

    page.locator("#save-recording").click()
    until(page, "document.querySelector('#saved').textContent.includes('two-live.rrd')", 60)
    replayed = subprocess.run([sys.argv[1], "replay", f"{folder}/two-live.rrd"], capture_output=True, text=True)
    assert replayed.returncode == 0 and "identical" in replayed.stdout, replayed.stdout + replayed.stderr

    page.locator("#save-scene").click()
    until(page, "document.querySelector('#saved').textContent.includes('two-live.toml')", 60)
    with open(f"{folder}/two-live.toml") as file:
        scene = file.read()
    assert "[[edit]]" in scene and "[[point]]" in scene, scene
    page.reload()
    until(page, "document.querySelector('#toml').textContent.includes('[[point]]') && run !== null", 60)
    assert "[[edit]]" in page.inner_text("#toml"), page.inner_text("#toml")
    return drag


def main():
    folder = tempfile.mkdtemp()
    command = [sys.argv[1], "live", "two", "--bind", "127.0.0.1:0", "--save", f"{folder}/two-live.rrd"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    address = process.stdout.readline().strip()
    if not re.fullmatch(r"http://127\.0\.0\.1:\d+/[0-9a-f]{32}/", address):
        process.kill()
        sys.exit(f"the program does not print its address first: {address!r} {process.stderr.read()}")
    requests, messages = [], []
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", headless=True, args=FLAGS)
            context = browser.new_context(viewport={"width": 1400, "height": 860})
            context.on("request", lambda request: requests.append(request.url))
            page = context.new_page()
            page.on("pageerror", lambda error: messages.append(str(error)))
            page.goto(address + "?renderer=webgl")
            drag = check(page, folder)
            browser.close()
    except Exception as error:
        sys.exit(f"the page of `live`: {error!r}; errors in the page: {messages}")
    finally:
        process.send_signal(signal.SIGINT)
        status = process.wait(15)
    others = [url for url in requests if urlsplit(url).hostname != "127.0.0.1" and not url.startswith(("data:", "blob:"))]
    if others or messages or status != 0:
        sys.exit(f"requests to other machines: {others}; errors in the page: {messages}; exit status {status}")
    print(f"page of live: events, links, thresholds and saving work; a drag of 100 positions ends on the last "
          f"{drag:.1f} s after it; {len(requests)} requests, all to this machine")


if __name__ == "__main__":
    main()
