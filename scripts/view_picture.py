#!/usr/bin/env python3
"""Opens a recording of `palpate view` in Rerun's web viewer and takes a picture of it.

    palpate view data/plant_a/seq_000 data/plant_a/seq_001 --save touches.rrd
    scripts/view_picture.py touches.rrd docs/guide/src/images/view.jpg [--across PART]

Serves the file on loopback by the command `rerun`, with its usage statistics off, and opens it in
a headless Chromium, which renders without a graphics card. `--across` is the moment that is shown, as
a part of all time. Made with rerun-sdk 0.36.0 and playwright 1.54.0, which need no browser of
their own where `chromium` is in PATH or CHROME says where one is.
"""

import argparse
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse

from playwright.sync_api import sync_playwright

SIZE = {"width": 1600, "height": 1000}
TIMES, TIMES_Y = (230, 1391), 986  # px, from the first time to the last, and their height
PATIENCE_S = 90  # software rendering is slow
SOFTWARE_GL = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--ignore-gpu-blocklist"]


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def serve(recording, settings):
    """Starts the server; returns its process and the page's address."""
    environment = os.environ | {"XDG_CONFIG_HOME": settings}
    subprocess.run(["rerun", "analytics", "disable"], env=environment, check=True, capture_output=True)
    page, data = free_port(), free_port()
    command = ["rerun", "--serve-web", "--bind", "127.0.0.1", "--web-viewer-port", str(page)]
    command += ["--port", str(data), "--hide-welcome-screen", recording]
    server = subprocess.Popen(command, env=environment, start_new_session=True)
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        try:
            socket.create_connection(("127.0.0.1", page), 1).close()
            break
        except OSError:
            time.sleep(0.2)
    source = urllib.parse.quote(f"rerun+http://127.0.0.1:{data}/proxy", safe="")
    return server, f"http://127.0.0.1:{page}/?url={source}&hide_welcome_screen=1"


def format_of(picture):
    return {"type": "jpeg", "quality": 88} if picture.endswith(".jpg") else {"type": "png"}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording")
    parser.add_argument("picture")
    parser.add_argument("--across", type=float, default=0.7, help="moment of the picture, as a share of the duration")
    parser.add_argument("--settle", type=float, default=60.0, help="time to wait before the picture, s")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as settings, sync_playwright() as playwright:
        server, address = serve(asked.recording, settings)
        try:
            chromium = os.environ.get("CHROME") or shutil.which("chromium")
            browser = playwright.chromium.launch(executable_path=chromium, args=SOFTWARE_GL)
            page = browser.new_page(viewport=SIZE, color_scheme="dark")
            page.on("pageerror", lambda error: print(error, file=sys.stderr))
            page.goto(address)
            page.wait_for_selector("canvas", timeout=PATIENCE_S * 1000)
            page.wait_for_timeout(asked.settle * 1000)
            page.mouse.click(TIMES[0] + asked.across * (TIMES[1] - TIMES[0]), TIMES_Y)
            page.keyboard.press("Space")  # it plays from there: pause
            page.wait_for_timeout(asked.settle * 250)
            page.screenshot(path=asked.picture, timeout=PATIENCE_S * 1000, **format_of(asked.picture))
            browser.close()
        finally:
            os.killpg(server.pid, signal.SIGTERM)  # the command may have started the server in turn
            server.wait()


if __name__ == "__main__":
    main()
