"""A real browser without a screen: Chromium with software WebGL, driven by its own protocol."""

import base64
import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import connect
from websockets.sync.connection import Connection

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(PROGRAM is None, reason="there is no Chromium here")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--remote-debugging-port=0", "--no-first-run"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-sandbox"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--force-device-scale-factor=1", "--hide-scrollbars", "--mute-audio"),
)
SECONDS = 60  # for any answer


class Page:
    """A tab."""

    def __init__(self, socket: Connection):
        self._socket, self._number = socket, 0
        self.events: list[dict[str, Any]] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """What the browser answers to a command of its protocol."""
        self._number += 1
        command = {"id": self._number, "method": method, "params": parameters}
        self._socket.send(json.dumps(command))
        while True:
            answer = json.loads(self._socket.recv(SECONDS))
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]
            self.events.append(answer)

    def open(self, url: str) -> None:
        """Load a page; what was said of those before is forgotten."""
        self.events.clear()
        self.call("Page.navigate", url=url)
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(json.loads(self._socket.recv(SECONDS)))

    def evaluate(self, expression: str) -> Any:
        """The value of an expression, awaited if it is a promise."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait for an expression to become true."""
        again = f"const again = () => ({expression}) ? done() : requestAnimationFrame(again)"
        self.evaluate(f"new Promise((done) => {{ {again}; again(); }})")

    def mouse(self, what: str, x: float, y: float, **options: Any) -> None:
        """Move, press or release the left button, in pixels of the page."""
        kinds = {"move": "mouseMoved", "press": "mousePressed", "release": "mouseReleased"}
        pressed = {"button": "left", "clickCount": 1} if what != "move" else {}
        options = {**pressed, **options}
        self.call("Input.dispatchMouseEvent", type=kinds.get(what, what), x=x, y=y, **options)

    def screenshot(self) -> np.ndarray:
        """The page as it looks, [H, W, 3] bytes."""
        content = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.array(Image.open(BytesIO(content)).convert("RGB"))

    def complaints(self) -> list[str]:
        """Errors and warnings of the console, and exceptions that nobody caught."""
        self.evaluate("0")  # what was said before is here then
        said = []
        for event in self.events:
            details = event.get("params", {})
            if event.get("method") == "Runtime.exceptionThrown":
                said.append(str(details["exceptionDetails"]))
            entry = details.get("entry", {})
            if event.get("method") == "Log.entryAdded" and entry["level"] in ("error", "warning"):
                said.append(entry["text"])
            is_call = event.get("method") == "Runtime.consoleAPICalled"
            if is_call and details["type"] in ("error", "warning", "assert"):
                said.append(str([each.get("value") for each in details["args"]]))
        return said


@contextmanager
def launched(width: int = 800, height: int = 600, *flags: str) -> Iterator[Page]:
    """A browser with one empty tab of a size, and a profile of its own that goes with it."""
    assert PROGRAM is not None
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [PROGRAM, *FLAGS, *flags, f"--user-data-dir={profile}", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        try:
            with connect(_address(process), max_size=None) as socket:
                page = Page(socket)
                for domain in ("Page", "Runtime", "Log"):
                    page.call(f"{domain}.enable")
                page.call(
                    "Emulation.setDeviceMetricsOverride",
                    **{"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
                )
                yield page
        finally:
            process.terminate()
            process.communicate()


def _address(process: "subprocess.Popen[bytes]") -> str:
    """Where the tab listens, from what the browser says when it starts."""
    assert process.stderr is not None
    for line in process.stderr:
        if b"DevTools listening on" in line:
            port = line.split(b"127.0.0.1:")[1].split(b"/")[0].decode()
            with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=SECONDS) as answer:
                tabs = json.load(answer)
            return next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
    raise AssertionError("Chromium did not start")


def as_url(path: Path) -> str:
    """A file as a browser opens it from the disk."""
    return path.resolve().as_uri()
