"""A headless browser, driven through a pipe with Python's standard library alone."""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time


class Browser:
    """chromium-headless-shell with its DevTools protocol on file descriptors 3 and 4."""

    def __init__(self, program):
        to_read, self.write_end = os.pipe()
        self.read_end, to_write = os.pipe()
        # The browser requires these two descriptors.
        high_read, high_write = (os.dup(end) for end in (to_read, to_write))

        def connect():
            first, second = os.dup(high_read), os.dup(high_write)
            os.dup2(first, 3)
            os.dup2(second, 4)

        self.profile = tempfile.mkdtemp()
        options = ["--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-pipe"]
        self.process = subprocess.Popen(
            [program, *options, f"--user-data-dir={self.profile}", "about:blank"],
            preexec_fn=connect, close_fds=False, stderr=subprocess.DEVNULL,
        )
        for end in (to_read, to_write, high_read, high_write):
            os.close(end)
        self.pending, self.number, self.events = b"", 0, []

    def receive(self):
        while b"\0" not in self.pending:
            part = os.read(self.read_end, 1 << 20)
            if not part:
                raise SystemExit("the browser has ended")
            self.pending += part
        message, self.pending = self.pending.split(b"\0", 1)
        return json.loads(message)

    def call(self, method, session=None, **parameters):
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self.write_end, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.receive()
            if answer.get("id") != self.number:
                self.events.append(answer)
            elif "error" in answer:
                raise SystemExit(f"{method}: {answer['error']}")
            else:
                return answer["result"]

    def close(self):
        try:
            self.call("Browser.close")
        except (OSError, SystemExit):
            pass
        self.process.wait(10)
        shutil.rmtree(self.profile, ignore_errors=True)


class Tab:
    """A page in the browser."""

    def __init__(self, browser, url, width, height, scheme):
        self.browser = browser
        target = browser.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = browser.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(domain + ".enable")
        self.size(width, height)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.call("Page.navigate", url=url)

    def call(self, method, **parameters):
        return self.browser.call(method, self.session, **parameters)

    def size(self, width, height):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)

    def script(self, expression):
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise SystemExit(f"{expression}: {answer['exceptionDetails']['text']}")
        return answer["result"].get("value")

    def wait(self, expression, seconds=120):
        """Waits until the expression is true."""
        end = time.monotonic() + seconds
        while not self.script(expression):
            if time.monotonic() > end:
                raise SystemExit(f"after {seconds} s still not true: {expression}")
            time.sleep(0.05)

    def key(self, key, code):
        for kind in ("keyDown", "keyUp"):
            text = {"Enter": "\r"}.get(key, key) if kind == "keyDown" else ""
            self.call("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, text=text)

    def click(self, name):
        x, y = self.script(
            f"(() => {{ const box = document.getElementById('{name}'); box.scrollIntoView(); "
            "const {x, y, width, height} = box.getBoundingClientRect(); return [x + width / 2, y + height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def picture(self, path, whole=True):
        data = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"]
        with open(path, "wb") as file:
            file.write(base64.b64decode(data))
