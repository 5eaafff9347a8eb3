"""Chromium, the studio and exported pages in it."""

import base64
import json
import re
import shutil
import subprocess
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar
from urllib.request import urlopen

import numpy as np
import pytest
import torch
from PIL import Image
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from balls import CAMERAS, PICKS, SPLATS
from scenes import layer_towards
from stylesplat.figures.browser import camera_of
from stylesplat.io.scene_folder import open, save
from stylesplat.rendering.shares import coverage
from stylesplat.scene.compose import with_layers
from stylesplat.scene.layer import without_identities
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.studio import StudioServer
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.style import Style

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


# The balls with two of them painted, and what is in a page of them.

TIMES = 5  # so many Gaussians for one: more than a line of a texture or an instance holds
PICKED = {name: PICKS[name].repeat(TIMES) for name in ("red", "green", "blue")}


def scene() -> Scene:
    """2,200 Gaussians of all sizes, shapes and turns, whose colours depend on the view."""
    generator = torch.Generator().manual_seed(3)

    def noise(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    rows = torch.arange(len(SPLATS)).repeat(TIMES)
    count = len(rows)
    before = replace(
        SPLATS[rows],
        means=SPLATS.means[rows] + 0.03 * noise(count, 3),
        quats=noise(count, 4),
        scales=SPLATS.scales[rows]
        - torch.where(rows % 3 == 0, 3.5, 0.5)[:, None]
        + 0.4 * noise(count, 3),
        opacities=0.5 + noise(count),
        shN=(0.1 * noise(300, 15, 3))[torch.arange(count) % 300],  # more than a palette holds
    )
    painted = PICKED["red"] | PICKED["blue"]
    sh0 = torch.where(painted[:, None, None], sh0_from_rgb(before.sh0.abs() % 1), before.sh0)
    shN = torch.where(painted[:, None, None], 0 * before.shN, before.shN)
    faded = torch.where(painted & (torch.arange(count) % 7 == 0), -16.0, before.opacities)
    after = replace(before, sh0=sh0, shN=shN, opacities=faded)
    scene = Scene(
        splats=before,
        cameras=CAMERAS,
        objects={name: SceneObject(picked) for name, picked in PICKED.items()},
    )
    layers = [layer_towards(before, after, PICKED[name], name) for name in ("red", "blue")]
    rows = PICKED["red"].nonzero()[::7, 0]
    canvas = replace(after[rows], means=after.means[rows] + 0.01, opacities=before.opacities[rows])
    canvas = without_identities(canvas)
    colors = {"canvas": canvas, "canvas_sh0": before.sh0[rows], "parents": rows}
    relief = torch.zeros(len(layers[0].rows) + len(rows))
    layers[0] = replace(layers[0], **colors, relief=relief)
    return with_layers(scene, layers)


@dataclass(frozen=True)
class Read:
    """What a page holds, its numbers as they are meant."""

    about: dict[str, Any]
    splats: Splats
    before: Splats


def element(page: str, name: str) -> str:
    found = re.search(rf'<script type="[^"]*" id="{name}">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return found[1]


def read(page: str) -> Read:
    """The same as `unpack.js` does."""
    about = json.loads(element(page, "about"))
    content = zlib.decompress(base64.b64decode(element(page, "splats")))
    columns = _Columns(np.frombuffer(content, np.uint8).astype(np.float64))
    count, painted, bands = about["count"], about["painted"], about["bands"]
    high_low = columns.take(3, 2, count)
    low, high = np.array(about["means"]).T[:, :, None]
    places = low + (high - low) * (256 * high_low[:, 0] + high_low[:, 1]) / 65535
    means = np.array(about["middle"])[:, None] + about["reach"] * np.sinh(places)
    scales = _between(columns.take(3, count), about["scales"])
    largest, others = columns.take(count).astype(int), columns.take(3, count)
    opacities = columns.take(count) / 255
    after = _between(columns.take(3, count), about["colors"])
    is_painted = columns.take(count) > 0
    before = after.copy()
    before[:, is_painted] = _between(columns.take(3, painted), about["colors"])
    earlier_opacities = opacities.copy()
    earlier_opacities[is_painted] = columns.take(painted) / 255
    strongest = np.array(about["strongest"])[:, None, None, None]
    palettes = (columns.take(2, bands, 256, 3) - 128) / 127 * strongest
    entries = columns.take(2, count).astype(int) if bands else np.zeros((2, count), int)
    earlier = entries.copy()
    earlier[:, is_painted] = columns.take(2, painted) if bands else 0
    assert columns.start == len(content), "nothing follows"
    quats = [
        np.insert(turn, place, np.sqrt(max(0, 1 - turn @ turn)))
        for turn, place in zip((others.T / 255 * 2 - 1) * 0.5**0.5, largest, strict=True)
    ]
    splats = Splats(
        means=_tensor(means.T),
        quats=_tensor(np.array(quats)),
        scales=_tensor(scales.T),
        opacities=_tensor(opacities).logit(),
        sh0=sh0_from_rgb(_tensor(after.T))[:, None],
        shN=_tensor(sum(palettes[level][:, entries[level]] for level in (0, 1))).transpose(0, 1),
    )
    shN = _tensor(sum(palettes[level][:, earlier[level]] for level in (0, 1))).transpose(0, 1)
    earlier_splats = replace(
        splats,
        sh0=sh0_from_rgb(_tensor(before.T))[:, None],
        shN=shN,
        opacities=_tensor(earlier_opacities).logit(),
    )
    return Read(about, splats, earlier_splats)


class _Columns:
    def __init__(self, values: np.ndarray):
        self.values, self.start = values, 0

    def take(self, *shape: int) -> np.ndarray:
        count = int(np.prod(shape))
        self.start += count
        return self.values[self.start - count : self.start].reshape(shape)


def _between(values: np.ndarray, bounds: list[float]) -> np.ndarray:
    return bounds[0] + (bounds[1] - bounds[0]) * values / 255


def _tensor(values: Any) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))


# The studio's page in a real browser: its buttons, sliders and downloads.

T = TypeVar("T")

PATIENCE = 120.0  # seconds: of a machine that does much else
KEYS = {"Home": 36, "ArrowRight": 39, "B": 66}  # with the numbers that the protocol has for them
RESTING = """async found => {
    if (!found || [...document.images].some(image => !image.complete)) return null;
    found.scrollIntoView({block: 'center'});
    const boxes = [];
    for (let frame = 0; frame < 3; frame++) {
        const box = found.getBoundingClientRect();
        boxes.push([box.x, box.y, box.width, box.height]);
        await new Promise(requestAnimationFrame);
    }
    const [x, y, width, height] = boxes[0];
    // In a folder that is not open yet it has a place as well
    const hit = found.contains(document.elementFromPoint(x + width / 2, y + height / 2));
    return hit && boxes.every(box => String(box) === String(boxes[0])) ? boxes[0] : null;
}"""
BUTTON = """(() => {
    const folders = '.mantine-Paper-root:not(:has(.mantine-Paper-root))';
    const all = [...document.querySelectorAll(`button, [role=tab], [role=slider], ${folders}`)];
    const fits = e => [(e.innerText || '').trim(), e.getAttribute('role')].includes(LABEL);
    return all.find(e => fits(e) && e.getClientRects().length);
})()"""
PICTURE = """[...document.images].find(
    e => e.offsetParent && e.parentElement.previousElementSibling?.textContent === LABEL)"""
FILES = "document.querySelector('input[type=file]')"
LAST_SLIDER = "[...document.querySelectorAll('[role=slider]')].filter(e => e.offsetParent).at(-1)"


class Tab:
    """The studio as who sits before it has it."""

    def __init__(self, page: Page) -> None:
        self.page = page

    def click(self, x: float, y: float) -> None:
        for what in ("move", "press", "release"):
            self.page.mouse(what, x, y)

    def press(self, key: str) -> None:
        self.hold(key, True)
        self.hold(key, False)

    def hold(self, key: str, down: bool) -> None:
        code = f"Key{key}" if len(key) == 1 else key
        words = {"type": "keyDown" if down else "keyUp", "key": key.lower(), "code": code}
        words = words if len(key) == 1 else {**words, "key": key}
        self.page.call("Input.dispatchKeyEvent", **words, windowsVirtualKeyCode=KEYS[key])

    def press_button(self, label: str) -> None:
        """Click what has these words on it, as soon as it is there."""
        self.click(*until(lambda: self.place_of(label), f"a button {label!r}"))

    def place_of(self, label: str) -> tuple[float, float] | None:
        """Its middle; None for as long as it is not there, or moves."""
        found = self._box(BUTTON, label)
        return (found[0] + found[2] / 2, found[1] + found[3] / 2) if found else None

    def _box(self, element: str, label: str) -> list[float] | None:
        """Left, top, width and height of what no longer moves."""
        return self.page.evaluate(f"({RESTING})({element.replace('LABEL', json.dumps(label))})")

    def unfold(self, label: str, title: str) -> None:
        """Click a heading until a picture shows beneath; a click is lost while the panel grows."""
        for _ in range(4):
            self.press_button(label)
            with suppress(AssertionError):
                until(lambda: self._box(PICTURE, title), f"a picture {title!r}", PATIENCE / 8)
                return

    def drag_on(self, title: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """From one place on a picture of the panel to another, in shares of it."""
        found = until(lambda: self._box(PICTURE, title), f"a picture {title!r}")
        x, y, width, height = found
        places = [(x + a * width, y + b * height) for a, b in (start, end)]
        self.page.mouse("move", *places[0])
        self.page.mouse("press", *places[0])
        self.page.mouse("move", *places[1], buttons=1)
        self.page.mouse("release", *places[1])

    def give(self, file: Path) -> None:
        """Choose a file for the button that asks for one."""
        found = self.page.call("Runtime.evaluate", expression=FILES)["result"]["objectId"]
        self.page.call("DOM.setFileInputFiles", files=[str(file)], objectId=found)

    def focus_last_slider(self) -> None:
        """As soon as there is one."""
        until(lambda: self.place_of("slider"), "a slider")
        self.page.evaluate(f"{LAST_SLIDER}.focus()")

    def text(self) -> str:
        return self.page.evaluate("document.body.innerText") or ""


def until(ask: Callable[[], T | None], what: str, seconds: float = PATIENCE) -> T:
    """The first answer that is one."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        answer = ask()
        if answer is not None and answer is not False:
            return answer
        time.sleep(0.05)
    raise AssertionError(f"Waited {seconds:g} s for {what}.")


def center_of(opened: StudioServer, name: str) -> tuple[float, float]:
    """Where an object shows on the page."""
    (client,) = opened.server.get_clients().values()
    camera = camera_of(client)
    scene = opened.session.state.scene
    seen = coverage(scene.splats, camera, opened.session.masks.of(scene, name))
    y, x = (each.float().mean().item() for each in (seen > 0.8).nonzero(as_tuple=True))
    return x, y


@contextmanager
def studio_tab(*, size: tuple[int, int], downloads: Path) -> Iterator[Tab]:
    """An empty page, and where its downloads go."""
    with launched(*size) as page:
        page.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(downloads))
        yield Tab(page)


# A session with the balls, and quick styles.

QUICK = StyleConfig(steps=4, layers=(1,), object_size=30)


def session_in(folder: Path) -> Session:
    """The balls, saved and opened."""
    path = folder / "balls"
    save(Scene(SPLATS, CAMERAS), path)
    return Session(open(path), folder=path)


def stripes() -> torch.Tensor:
    rows = (torch.arange(64) // 6 % 2).float()
    return torch.stack([rows, 0.3 + 0 * rows, 1 - rows], dim=-1)[:, None].expand(64, 64, 3).clone()


def quick_style() -> Style:
    return Style(stripes(), config=QUICK)
