#!/usr/bin/env python3
"""Opens a recording in the real viewer, headless, and asserts on what it shows.

    viewer.py RECORDING.rrd TIMELINE@VALUE TEXT [TEXT ...]    [PICTURE=F.png in the environment: keeps a picture]
                                                    [PICTURE_OF=text: nothing is drawn in 3D]

Exit status 1 if a TEXT is not visible at that time, if the 3D view is empty, or if the viewer does not answer.
"""
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time

from PIL import Image

LIMIT = 120  # seconds for everything


class Viewer:
    """A headless viewer, and the control server that drives it."""

    def __init__(self, recording):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        environment = dict(os.environ, RERUN_ANALYTICS="0", RUST_LOG="error")
        environment.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
        quiet = dict(env=environment, stderr=subprocess.DEVNULL, start_new_session=True)
        command = ["rerun", "--headless", "--bind", "127.0.0.1", "--port", str(self.port)]
        command += ["--window-size", "1280x720", "--hide-welcome-screen", recording]
        self.window = subprocess.Popen(command, stdout=subprocess.DEVNULL, **quiet)
        pipes = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.control = subprocess.Popen(["rerun", "viewer-mcp"], **pipes, **quiet)
        self.calls = 0
        client = {"protocolVersion": "2024-11-05", "capabilities": {}, "clientInfo": {"name": "ci", "version": "1"}}
        self.call("initialize", client)
        self.send({"jsonrpc": "2.0", "method": "notifications/initialized", "params": {}})

    def send(self, message):
        self.control.stdin.write(json.dumps(message) + "\n")
        self.control.stdin.flush()

    def call(self, method, parameters):
        self.calls += 1
        self.send({"jsonrpc": "2.0", "id": self.calls, "method": method, "params": parameters})
        for line in self.control.stdout:
            reply = json.loads(line)
            if reply.get("id") == self.calls:
                if "error" in reply:
                    raise RuntimeError(f"{method}: {reply['error']}")
                return reply["result"]
        raise RuntimeError("the viewer's control server has exited")

    def tool(self, name, **arguments):
        result = self.call("tools/call", {"name": name, "arguments": arguments})
        text = "\n".join(part["text"] for part in result.get("content", []) if part.get("type") == "text")
        if result.get("isError"):
            raise RuntimeError(f"{name}: {text}")
        return text

    def texts(self):
        nodes = json.loads(self.tool("query_tree", limit=5000))["nodes"]
        return [node["value"] or node["label"] or "" for node in nodes if node["bounds"] and not node["hidden"]]

    def close(self):
        for process in (self.control, self.window):  # `rerun` is a script: also end the program that it started
            for how in (signal.SIGTERM, signal.SIGKILL):
                try:
                    os.killpg(process.pid, how)
                    process.wait(3)
                except (ProcessLookupError, subprocess.TimeoutExpired):
                    continue


def until(deadline, attempt):
    """The first true result of `attempt`, tried until the deadline; errors count as false."""
    while True:
        error = None
        try:
            result = attempt()
            if result:
                return result
        except RuntimeError as failure:
            error = failure
        if time.time() > deadline:
            raise RuntimeError(f"no answer in time ({error})")
        time.sleep(0.5)


def is_colourful(picture):
    """Whether the 3D view, left in the window, shows bodies and lines, not only a background."""
    if os.environ.get("PICTURE_OF") == "text":  # a layout without 3D
        return True
    view = Image.open(picture).convert("RGB").crop((20, 60, 700, 520))
    return len(view.getcolors(maxcolors=1 << 24)) > 500


def main():
    recording, when, *wanted = sys.argv[1:]
    timeline, _, value = when.partition("@")
    deadline = time.time() + LIMIT
    viewer = Viewer(recording)
    try:
        until(deadline, lambda: viewer.tool("connect", endpoint=f"http://127.0.0.1:{viewer.port}") or True)
        until(deadline, lambda: any(r["timelines"] for r in json.loads(viewer.tool("viewer_state"))["recordings"]))
        missing = wanted
        def complete():
            nonlocal missing
            # repeat: while a file loads, the cursor cannot pass the data read so far
            viewer.tool("set_time", timeline=timeline, time=int(value))
            shown = viewer.texts()
            missing = [text for text in wanted if not any(text in line for line in shown)]
            return not missing
        try:
            until(min(deadline, time.time() + 20), complete)
        except RuntimeError:
            sys.exit(f"{recording} at {when} does not show: {missing}\nit shows: {viewer.texts()}")

        with tempfile.TemporaryDirectory() as folder:
            picture = os.environ.get("PICTURE") or os.path.join(folder, "view.png")
            def drawn():
                viewer.tool("screenshot", save_path=os.path.abspath(picture), pixels_per_point=1.0)
                return is_colourful(picture)
            try:
                until(min(deadline, time.time() + 20), drawn)
            except RuntimeError:
                sys.exit(f"{recording} at {when}: the 3D view is empty")
    except RuntimeError as error:
        sys.exit(f"{recording}: {error}")
    finally:
        viewer.close()
    print(f"{os.path.basename(recording)} at {when}: {len(wanted)} texts and a picture")


if __name__ == "__main__":
    main()
