"""A page in Chromium, as a person uses it."""

import json
import subprocess
import tempfile
import time
from pathlib import Path
from urllib.request import urlopen

from websockets.sync.client import connect


class Browser:
    """A page in headless Chromium, by its own debugging protocol."""

    def __init__(self, address):
        self.profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--window-size=1400,900"]
        self.program = subprocess.Popen(
            ["/usr/bin/chromium", *arguments, f"--user-data-dir={self.profile.name}", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,  # whoever waits for our output waits for no browser
        )
        self.sent = 0
        try:
            self.socket = connect(until(self.debugged), max_size=None)
            self.open(address)
        except BaseException:
            self.close()
            raise

    def debugged(self):
        """Where a page is debugged, once the browser has begun: it first makes the file that says so, then fills it."""
        file = Path(self.profile.name) / "DevToolsActivePort"
        said = file.read_text().split() if file.exists() else []
        if len(said) < 2:
            return None
        listed = json.load(urlopen(f"http://127.0.0.1:{said[0]}/json", timeout=60))
        return next((one["webSocketDebuggerUrl"] for one in listed if one["type"] == "page"), None)

    def send(self, method, **params):
        self.sent += 1
        self.socket.send(json.dumps({"id": self.sent, "method": method, "params": params}))
        while (answer := json.loads(self.socket.recv(timeout=60))).get("id") != self.sent:
            pass
        assert "error" not in answer, answer
        return answer["result"]

    def open(self, address):
        self.send("Page.navigate", url=address)
        until(lambda: self.said("window.evermap?.taught?.revision > 0 && document.getElementById('busy').textContent === ''"))

    def said(self, expression):
        answer = self.send("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def text(self, name):
        return self.said(f"document.getElementById('{name}').textContent")

    def click(self, place, view="evermap.map"):
        """Clicks a place of a view, which is all that a page shows."""
        self.drag([place], view)
        time.sleep(0.3)  # two clicks within a quarter of a second are one double click

    def drag(self, places, view="evermap.map"):
        """Holds the button from the first place to the last."""
        pixels = [self.said(f"{view}.getPixelFromCoordinate({json.dumps(place)})") for place in places]
        mouse = lambda kind, at, **more: self.send("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], **more)
        mouse("mouseMoved", pixels[0])
        mouse("mousePressed", pixels[0], button="left", clickCount=1)
        for at in pixels[1:]:
            mouse("mouseMoved", at, button="left", buttons=1)
        mouse("mouseReleased", pixels[-1], button="left", clickCount=1)

    def press(self, key):
        text = "\r" if key == "Enter" else key if len(key) == 1 else ""
        for kind in ["keyDown", "keyUp"]:
            self.send("Input.dispatchKeyEvent", type=kind, key=key, text=text if kind == "keyDown" else "")

    def close(self):
        self.program.kill()
        self.program.wait()
        self.profile.cleanup()


def until(what, seconds=60):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := what():
            return found
        time.sleep(0.02)
    raise TimeoutError(what)
