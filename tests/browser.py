"""Chromium, the studio and exported pages in it."""

import base64
import json
import re
import shutil
import subprocess
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
import pytest
import torch
from PIL import Image
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from balls import CAMERAS, PICKS, SPLATS
from scenes import layer_towards
from stylesplat.io.scene_folder import open, save
from stylesplat.scene.layers import appearance_only
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.studio_app.session import Session
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
        self.profile: dict[str, Any] = {}
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
        loads = 1 + ("/?token=" in url)  # which leads to the same address without it
        while [each.get("method") for each in self.events].count("Page.loadEventFired") < loads:
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


class Browser:
    """A Chromium that runs."""

    def __init__(self, address: str):
        self._address = address  # of the whole browser; each tab has one of its own

    @contextmanager
    def tab(self, width: int = 800, height: int = 600) -> Iterator[Page]:
        """An empty tab of a size, with a profile of its own that goes with it."""
        with _connected(self._address) as browser:
            context = browser.call("Target.createBrowserContext")
            try:
                tab = browser.call("Target.createTarget", url="about:blank", **context)["targetId"]
                root, _, _ = self._address.partition("/devtools/")
                with _connected(f"{root}/devtools/page/{tab}") as page:
                    page.profile = context
                    for domain in ("Page", "Runtime", "Log"):
                        page.call(f"{domain}.enable")
                    size = {"width": width, "height": height}
                    page.call(
                        "Emulation.setDeviceMetricsOverride",
                        **{**size, "deviceScaleFactor": 1, "mobile": False},
                    )
                    yield page
            finally:
                browser.call("Target.disposeBrowserContext", **context)


@contextmanager
def _connected(address: str) -> Iterator[Page]:
    with connect(address, max_size=None, ping_interval=None) as socket:
        yield Page(socket)


@contextmanager
def launched() -> Iterator[Browser]:
    """A browser that ends with the block."""
    assert PROGRAM is not None
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [PROGRAM, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        try:
            assert process.stderr is not None
            said = (re.search(r"listening on (\S+)", line.decode()) for line in process.stderr)
            found = next(filter(None, said), None)
            assert found is not None, "Chromium did not start"
            yield Browser(found[1])
        finally:
            process.terminate()
            process.communicate()


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
        base=before,
        cameras=CAMERAS,
        objects={name: SceneObject(picked) for name, picked in PICKED.items()},
    )
    layers = [layer_towards(before, after, PICKED[name], name) for name in ("red", "blue")]
    rows = PICKED["red"].nonzero()[::7, 0]
    surfels = replace(after[rows], means=after.means[rows] + 0.01, opacities=before.opacities[rows])
    surfels = appearance_only(surfels)
    colors = {"surfels": surfels, "surfels_sh0": before.sh0[rows], "parents": rows}
    relief = torch.zeros(len(layers[0].rows) + len(rows))
    layers[0] = replace(layers[0], **colors, relief=relief)
    return scene.with_layers(layers)


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
        antialiased=about["antialiased"],
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
KEYS = {
    "c": 67,
    "Home": 36,
    "End": 35,
    "ArrowLeft": 37,
    "ArrowRight": 39,
    "Enter": 13,
    "b": 66,
    "w": 87,
    "?": 191,
    "Escape": 27,
}  # as the protocol numbers them
# The middle of an element that lies on top and no longer moves
RESTING = """async (found) => {
    if (!found) return null;
    found.scrollIntoView({ block: "nearest", inline: "nearest" });
    const boxes = [];
    for (let frame = 0; frame < 3; frame++) {
        const box = found.getBoundingClientRect();
        boxes.push([box.x, box.y, box.width, box.height]);
        await new Promise(requestAnimationFrame);
    }
    const [x, y, width, height] = boxes[0];
    const middle = [x + width / 2, y + height / 2];
    const top = document.elementFromPoint(...middle);
    const still = boxes.every((box) => String(box) === String(boxes[0]));
    return still && width && found.contains(top) ? middle : null;
}"""
AXE = Path(__file__).parent / "axe/axe.min.js"
FILES = "document.querySelector('input[type=file]')"
VIEW = "document.querySelector('.view').dataset"


class Tab:
    """The studio as who sits before it has it."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.session: Session | None = None

    def open(self, url: str) -> None:
        """Load the page, until it shows the exact picture and knows what lies where in it."""
        self.page.open(url)
        until(lambda: self.page.evaluate("Boolean(window.studio)"), "the page")
        self.wait_until_idle()

    def wait_until_idle(self) -> None:
        """Wait for the picture, the map and the glow of the camera as it is."""
        now = f"String(studio.number) === {VIEW}.after && String(studio.number) === {VIEW}.map"
        until(lambda: self.page.evaluate(now), "the picture at rest")

    def click(self, x: float, y: float, **options: Any) -> None:
        for what in ("move", "press", "release"):
            self.page.mouse(what, x, y, **options)

    def drag(self, start: tuple[float, float], end: tuple[float, float], **options: Any) -> None:
        self.page.mouse("move", *start)
        self.page.mouse("press", *start, **options)
        middle = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
        for place in (middle, end):
            self.page.mouse("move", *place, button="left", buttons=1, **options)
        self.page.mouse("release", *end, **options)

    def key(self, key: str, down: bool, **options: Any) -> None:
        words = {"type": "keyDown" if down else "keyUp", "key": key, "code": key}
        options |= {"windowsVirtualKeyCode": KEYS[key]}
        self.page.call("Input.dispatchKeyEvent", **words, **options)

    def press_button(self, label: str) -> None:
        """Click the button that is labelled so or has these words on it, as soon as it is there."""
        self.click(*until(lambda: self.place_of(label), f"a button {label!r}"))

    def place_of(self, label: str) -> tuple[float, float] | None:
        """Its middle; None for as long as it is not there, or moves."""
        wanted = json.dumps(label)
        button = f"""[...document.querySelectorAll("button, [role=slider]")].find((each) =>
            !each.disabled && each.getClientRects().length &&
            [each.innerText.trim(), each.ariaLabel, each.title].some((text) =>
                text?.startsWith({wanted})))"""
        return self.page.evaluate(f"({RESTING})({button})")

    def give(self, file: Path) -> None:
        """Choose a file for the button that asks for one."""
        found = self.page.call("Runtime.evaluate", expression=FILES)["result"]["objectId"]
        self.page.call("DOM.setFileInputFiles", files=[str(file)], objectId=found)

    def assert_accessible(self) -> None:
        """No fault of what the page shows now, as axe-core finds them."""
        if not self.page.evaluate("Boolean(window.axe)"):
            self.page.evaluate(AXE.read_text(encoding="utf-8") + ";0")
        found = self.page.evaluate("""axe.run({ resultTypes: ["violations"] })
            .then(({ violations }) => violations
            .map(({ help, nodes }) => [help, nodes.map((node) => node.html)]))""")
        assert not found, json.dumps(found, indent=1)

    def slide(self, label: str, value: float) -> None:
        """Set a slider, as a pointer would."""
        found = f"document.querySelector('input[type=range][aria-label={json.dumps(label)}]')"
        until(lambda: self.page.evaluate(f"{found} && !{found}.disabled"), f"a slider {label}")
        event = "new Event('input', {bubbles: true})"
        self.page.evaluate(f"{found}.value = {value}; {found}.dispatchEvent({event})")

    def text(self) -> str:
        return self.page.evaluate("document.body?.innerText") or ""

    def picture(self) -> np.ndarray:
        """The exact picture that the page shows, without what lies over it."""
        self.wait_until_idle()
        content = self.page.evaluate("studio.after.toDataURL('image/png').split(',')[1]")
        return np.array(Image.open(BytesIO(base64.b64decode(content))).convert("RGB")).astype(float)

    def middle_of(self, name: str) -> tuple[float, float]:
        """Where an object shows on the page, in pixels of it."""
        self.wait_until_idle()
        return self.page.evaluate(f"""(() => {{
            const {{ ids, names, size }} = studio.overlay.map;
            const number = names.indexOf({json.dumps(name)}) + 1;
            const rows = [...ids.keys()].filter((row) => ids[row] === number);
            const at = (row) => [row % size[0], Math.floor(row / size[0])];
            const sum = (n) => rows.reduce((sum, row) => sum + at(row)[n], 0);
            const mean = [sum(0) / rows.length, sum(1) / rows.length];
            const away = (row) => Math.hypot(...at(row).map((value, n) => value - mean[n]));
            const [x, y] = at(rows.reduce((one, other) => (away(other) < away(one) ? other : one)));
            const box = studio.canvas.getBoundingClientRect();
            return [
                box.x + ((x + 0.5) / size[0]) * box.width,
                box.y + ((y + 0.5) / size[1]) * box.height,
            ];
        }})()""")


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
def studio_tab(browser: Browser, *, size: tuple[int, int], downloads: Path) -> Iterator[Tab]:
    """An empty page, and where its downloads go."""
    with browser.tab(*size) as page:
        place = {"behavior": "allow", "downloadPath": str(downloads)}
        page.call("Browser.setDownloadBehavior", **place, **page.profile)
        yield Tab(page)


# A session with the balls, and quick styles.

QUICK = StyleConfig(quality="draft", steps=4, block=1, object_size=30)


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
