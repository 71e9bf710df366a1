#!/usr/bin/env python3
"""Loads the embedded web viewer of `run --serve` in headless Chromium and reads what it shows.

    web.py MELDSCOPE          [PICTURE=F.png in the environment: keeps a picture]

The viewer draws on a canvas, so texts are read from a screenshot by OCR. Exit status 1 if the page does not load, if the
recording's name or the views' titles are missing, if the 3D view is empty, or if the page asks any machine but this one
for anything: every request is logged, also those that the browser refuses to send.
"""
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from urllib.parse import urlsplit

from PIL import Image
from playwright.sync_api import sync_playwright

FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--ignore-gpu-blocklist"]
WANTED = ["two", "Bodies, influence spheres", "Pair distances", "Pair phases", "Events", "532 vertices"]
# A request past the page's own check. Returns the directive that refuses it.
ESCAPE = """new Promise(resolve => {
    document.addEventListener("securitypolicyviolation", violation => resolve(violation.effectiveDirective));
    fetchAnything("https://example.com/", {mode: "no-cors"}).catch(() => {});
    setTimeout(() => resolve("nothing"), 5000);
})"""


def served(program):
    """Starts the program; returns its process once it serves, and the address to open."""
    command = [program, "run", "two", "--serve", "--bind", "127.0.0.1:0"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    address = None
    for line in process.stderr:
        found = re.search(r"http://\S+\?url=\S+", line)
        address = found.group(0) if found else address
        if "until Ctrl-C" in line:
            break
    if not address:
        process.kill()
        sys.exit("the program did not print its address")
    return process, address


def read(picture):
    large = Image.open(picture).convert("L")
    large = large.resize((large.width * 2, large.height * 2))
    with tempfile.NamedTemporaryFile(suffix=".png") as file:
        large.save(file.name)
        command = ["tesseract", file.name, "-", "--psm", "11"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def main():
    process, address = served(sys.argv[1])
    picture = os.environ.get("PICTURE") or os.path.join(tempfile.mkdtemp(), "web.png")
    missing, colours, requests = WANTED, 0, []
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", headless=True, args=FLAGS)
            context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="dark")
            context.on("request", lambda request: requests.append(request.url))
            page = context.new_page()
            page.goto(address + "&renderer=webgl")
            deadline = time.time() + 120  # the viewer is 41 MB of wasm, drawn in software
            while (missing or colours < 500) and time.time() < deadline:
                time.sleep(5)
                page.screenshot(path=picture)
                text = read(picture)
                missing = [wanted for wanted in WANTED if wanted not in text]
                view = Image.open(picture).convert("RGB").crop((20, 60, 700, 560))
                colours = len(view.getcolors(maxcolors=1 << 24))
            # a request that the page itself does not refuse is refused by the browser
            refused_by = page.evaluate(ESCAPE)
            browser.close()
    except Exception as error:  # report a page that does not load, without a stack trace
        sys.exit(f"the web viewer at {address}: {error}")
    finally:
        process.send_signal(signal.SIGINT)
    status = process.wait(15)
    if missing or colours < 500:
        sys.exit(f"the web viewer does not show {missing}; colours in the 3D view: {colours}; it shows:\n{text}")
    own = [url for url in requests if urlsplit(url).hostname == "127.0.0.1" or url.startswith(("data:", "blob:"))]
    others = [url for url in requests if url not in own and url != "https://example.com/"]
    if others or refused_by != "connect-src":
        sys.exit(f"the page asks other machines: {others}; the content security policy refuses: {refused_by}")
    if status != 0:
        sys.exit(f"the server ended with status {status} at Ctrl-C")
    print(f"web viewer: {len(WANTED)} texts and a 3D view of {colours} colours; {len(own)} requests, all to this machine")


if __name__ == "__main__":
    main()
