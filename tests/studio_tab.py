"""The studio's page in a real browser: its buttons, sliders and downloads."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from chromium import Page, launched
from stylesplat.figures.browser import camera_of
from stylesplat.rendering.shares import coverage
from stylesplat.studio_app.studio import StudioServer

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
