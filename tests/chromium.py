"""A browser without a window, driven by Chromium's own protocol."""

import base64
import io
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar
from urllib.request import urlopen

import numpy as np
from PIL import Image
from websockets.sync.client import connect
from websockets.sync.connection import Connection

T = TypeVar("T")
Place = tuple[float, float]

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--hide-scrollbars",
    "--disable-extensions",
    "--no-first-run",
    "--remote-debugging-port=0",
    "--remote-allow-origins=*",
    "--use-angle=swiftshader",  # WebGL 2 without a graphics card
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)
PATIENCE = 30.0  # seconds: of a machine that does much else
SHIFT = 8  # how the protocol calls that key


def find_chromium() -> str | None:
    return next(filter(None, map(shutil.which, NAMES)), None)


class Tab:
    """A page that is open."""

    def __init__(self, socket: Connection) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.complaints: list[str] = []
        """Errors of the page."""
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        kind = message.get("method")
        if kind == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(parameters["exceptionDetails"])[:600])
        elif kind == "Runtime.consoleAPICalled" and parameters["type"] == "error":
            values = [each.get("value", each.get("description")) for each in parameters["args"]]
            self.complaints.append(" ".join(map(str, values))[:600])
        elif kind == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.complaints.append(str(parameters["entry"].get("text"))[:600])

    def run(self, code: str) -> Any:
        result = self.call("Runtime.evaluate", expression=code, returnByValue=True)
        return result["result"].get("value")

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def click(self, x: float, y: float, modifiers: int = 0) -> None:
        place = {"x": x, "y": y, "modifiers": modifiers}
        self.call("Input.dispatchMouseEvent", type="mouseMoved", **place)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **place)

    def drag(
        self, start: tuple[float, float], end: tuple[float, float], modifiers: int = 0
    ) -> None:
        def event(kind: str, place: tuple[float, float], **more: Any) -> None:
            self.call(
                "Input.dispatchMouseEvent",
                type=kind,
                x=place[0],
                y=place[1],
                modifiers=modifiers,
                button="left",
                **more,
            )

        event("mousePressed", start, clickCount=1)
        for part in (0.5, 1.0):
            x, y = (a + part * (b - a) for a, b in zip(start, end, strict=True))
            event("mouseMoved", (x, y), buttons=1)
        event("mouseReleased", end, clickCount=1)

    def type(self, text: str) -> None:
        self.call("Input.insertText", text=text)

    def press(self, key: str) -> None:
        codes = {"Enter": 13, "Home": 36, "End": 35, "ArrowLeft": 37, "ArrowRight": 39}
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key,
                windowsVirtualKeyCode=codes[key],
            )

    def press_button(self, label: str) -> None:
        """Click what has these words on it, as soon as it is there."""
        place = until(lambda: self.place_of(label), f"a button {label!r}")
        self.click(*place)

    def place_of(self, label: str) -> tuple[float, float] | None:
        found = self.run(f"""(() => {{
            const all = [...document.querySelectorAll('button, [role=tab], [role=slider]')];
            const fits = e => [(e.innerText || '').trim(), e.getAttribute('role')]
                .includes({json.dumps(label)});
            const found = all.find(e => fits(e) && e.getClientRects().length);
            if (!found) return null;
            found.scrollIntoView({{block: 'center'}});
            const box = found.getBoundingClientRect();
            return [box.x + box.width / 2, box.y + box.height / 2];
        }})()""")
        return tuple(found) if found else None

    def text(self) -> str:
        return self.run("document.body.innerText") or ""

    def screenshot(self) -> np.ndarray:
        """The page, pixels as [H,W,3] bytes."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return np.array(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))


def until(ask: Callable[[], T | None], what: str, seconds: float = PATIENCE) -> T:
    """The first answer that is one."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        answer = ask()
        if answer is not None and answer is not False:
            return answer
        time.sleep(0.05)
    raise AssertionError(f"Waited {seconds:g} s for {what}.")


@contextmanager
def browser(*, size: tuple[int, int], downloads: Path) -> Iterator[Tab]:
    """An empty page, and where its downloads go."""
    program = find_chromium()
    assert program is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        flags = [*FLAGS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"]
        process = subprocess.Popen(
            [program, *flags, "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "HOME": profile},
        )
        try:
            with connect(_page_socket(Path(profile)), max_size=2**28) as socket:
                tab = Tab(socket)
                tab.call(
                    "Emulation.setDeviceMetricsOverride",
                    width=size[0],
                    height=size[1],
                    deviceScaleFactor=1,
                    mobile=False,
                )
                tab.call(
                    "Browser.setDownloadBehavior", behavior="allow", downloadPath=str(downloads)
                )
                yield tab
        finally:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _page_socket(profile: Path) -> str:
    def port() -> str | None:
        file = profile / "DevToolsActivePort"
        return file.read_text().split()[0] if file.exists() and file.read_text() else None

    address = f"http://127.0.0.1:{until(port, 'Chromium')}/json"

    def socket() -> str | None:
        with urlopen(address, timeout=PATIENCE) as answer:
            pages = [each for each in json.load(answer) if each["type"] == "page"]
        return pages[0]["webSocketDebuggerUrl"] if pages else None

    return until(socket, "a page")
