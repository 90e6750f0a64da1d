"""A real headless Chromium for tests of pages: opens one, runs JavaScript in it, moves the mouse, takes pictures. Standard library alone.

It is driven by the DevTools protocol over a pipe (Chromium's --remote-debugging-pipe): JSON texts that end with a zero byte.
"""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = ("--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
         "--disable-sync", "--disable-extensions", "--hide-scrollbars", "--mute-audio", "--use-angle=swiftshader",
         "--enable-unsafe-swiftshader", "--remote-debugging-pipe")


def chromium():
    """The path of a Chromium, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """A context manager around one page. `requests` has every address that the page asked for, `errors` what went wrong in it."""

    def __init__(self, width=1280, height=900):
        self.size, self.requests, self.errors, self.counter = (width, height), [], [], 0

    def __enter__(self):
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_child, self.out = os.pipe()
        self.inp, from_child = os.pipe()
        keep = [os.dup(fd) for fd in (to_child, from_child)]  # beyond 4, so that the child's 3 and 4 are free

        def arrange():
            os.dup2(keep[0], 3)
            os.dup2(keep[1], 4)

        own = (f"--user-data-dir={self.folder.name}", f"--window-size={self.size[0]},{self.size[1]}")
        self.process = subprocess.Popen([chromium(), *FLAGS, *own, "about:blank"], preexec_fn=arrange, pass_fds=(3, 4, *keep),
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for fd in (to_child, from_child, *keep):
            os.close(fd)
        self.buffer, self.session = b"", None
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")
        self.send("Emulation.setDeviceMetricsOverride", width=self.size[0], height=self.size[1], deviceScaleFactor=1, mobile=False)
        return self

    def __exit__(self, *_):
        try:
            self.session = None
            self.send("Browser.close")
        except (OSError, EOFError):
            pass
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self.out)
        os.close(self.inp)
        self.folder.cleanup()

    def send(self, method, **params):
        """The result of a command. Raises AssertionError where Chromium refuses it."""
        self.counter += 1
        message = {"id": self.counter, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.out, json.dumps(message).encode() + b"\0")
        while True:
            found = self._next()
            if found.get("id") == self.counter:
                assert "error" not in found, f"{method}: {found['error']}"
                return found["result"]

    def _next(self):
        while b"\0" not in self.buffer:
            part = os.read(self.inp, 1 << 20)
            if not part:
                raise EOFError
            self.buffer += part
        text, _, self.buffer = self.buffer.partition(b"\0")
        message = json.loads(text)
        params = message.get("params", {})
        if message.get("method") == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"]))
        elif message.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])
        return message

    def open(self, address):
        """Load a page."""
        self.send("Page.navigate", url=address)
        self.until("document.readyState === 'complete'")

    def run(self, expression):
        """The value of a JavaScript expression, a promise awaited."""
        found = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def until(self, expression, seconds=60):
        """Wait until it is true."""
        end = time.monotonic() + seconds
        while not self.run(f"!!({expression})"):
            assert time.monotonic() < end, f"{expression} is still not true; errors: {self.errors}"
            time.sleep(0.05)

    def mouse(self, kind, x, y, **more):
        """A mouse event: mousePressed, mouseMoved, mouseReleased, mouseWheel."""
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start, end, steps=6, **more):
        """Press, move, release."""
        self.mouse("mousePressed", *start, button="left", buttons=1, clickCount=1, **more)
        for k in range(1, steps + 1):
            self.mouse("mouseMoved", *(a + (b - a) * k / steps for a, b in zip(start, end)), button="left", buttons=1, **more)
        self.mouse("mouseReleased", *end, button="left", buttons=0, clickCount=1, **more)

    def dark(self, yes):
        """What the system prefers."""
        self.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark" if yes else "light"}])

    def picture(self, whole=False):
        """A PNG of the window, or of the whole page."""
        return base64.b64decode(self.send("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"])
