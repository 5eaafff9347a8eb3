"""The studio in a real browser: pick, paint, compare, undo, save, export."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from balls import CAMERAS, SPLATS, enlarged
from browser import Tab, center_of, needs_chromium, studio_tab, until
from stylesplat.figures.browser import camera_of
from stylesplat.io.scene_folder import open, save
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.rendering.shares import coverage
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.gallery import MOST_BYTES
from stylesplat.studio_app.page import MANY
from stylesplat.studio_app.paint_panel import TITLE
from stylesplat.studio_app.studio import StudioServer, studio

pytestmark = needs_chromium

SIZE = 760, 420  # pixels of the window: software draws them
# Messages, such as that of viser that nothing but software draws, lie over the picture
HIDE = "document.querySelectorAll('.mantine-Notifications-root').forEach(e => e.remove())"
VISERS = (
    # Its splats' corners are told without a z, by which three.js measures them at a click
    "THREE.BufferGeometry.computeBoundingSphere(): Computed radius is NaN.",
    "THREE.Clock: This module has been deprecated.",
)
COUNTED = """(() => {
    window.drawn = { splats: 0, others: 0 };
    const gl = WebGL2RenderingContext.prototype;
    const { drawElements, drawElementsInstanced } = gl;
    gl.drawElements = function (...given) {
        drawn.others += 1;
        drawElements.apply(this, given);
    };
    gl.drawElementsInstanced = function (...given) {
        drawn.splats += given[4] > MANY;
        drawElementsInstanced.apply(this, given);
    };
})()""".replace("MANY", str(MANY))
FAR = 8  # pixels around an object to which its strokes may reach
TILE = 10  # pixels
SLIGHT = 12  # of 255: JPEG, which pictures at rest are sent as, changes pixels by less


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudioServer]:
    """The balls, and a picture of stripes."""
    folder, styles = tmp_path / "balls", tmp_path / "styles"
    save(Scene(SPLATS, enlarged(CAMERAS, 4)), folder)
    styles.mkdir()
    rows = torch.arange(96) // 6 % 2
    pixels = torch.stack([200 * rows, 90 + 0 * rows, 255 - 200 * rows], dim=-1).to(torch.uint8)
    image = Image.fromarray(pixels[:, None].expand(96, 96, 3).numpy())
    image.save(styles / "stripes.png")
    monkeypatch.setattr("stylesplat.studio_app.save_panel.FRAMES", 6)
    found = studio(folder, styles=styles, port=0, block=False, device="cpu")
    found.session.greetings.append("The studio of all browsers.")
    yield found
    found.close()


@pytest.fixture
def tab(opened: StudioServer, tmp_path: Path) -> Iterator[Tab]:
    downloads = tmp_path / "downloads"
    downloads.mkdir()
    with studio_tab(size=SIZE, downloads=downloads) as tab:
        tab.page.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTED)
        tab.page.open(opened.url)
        yield tab


def at_rest(tab: Tab, opened: StudioServer) -> np.ndarray:
    """What the page shows of the scene once there is nothing more to do."""
    (client,) = until(lambda: opened.server.get_clients() or None, "a browser")
    assert opened.session.worker.settle()

    def picture() -> np.ndarray | None:
        wanted = exact(opened)  # each time: the camera may move at first
        if not opened.page.viewport.rest.showing(client):
            return None
        tab.page.evaluate(HIDE)
        pixels = tab.page.screenshot().astype(float)[: wanted.shape[0], : wanted.shape[1]]
        return pixels if pixels.shape == wanted.shape and alike(pixels, wanted) else None

    return until(picture, "the exact picture on the page")


def alike(pixels: np.ndarray, wanted: np.ndarray) -> bool:
    """Whether no tile of two pictures differs by more than JPEG makes it."""
    (height, width), change = wanted.shape[:2], np.abs(pixels - wanted).mean(axis=2)
    tiles = change[: height // TILE * TILE, : width // TILE * TILE]
    tiles = tiles.reshape(height // TILE, TILE, width // TILE, TILE).mean(axis=(1, 3))
    return bool(tiles.max() < SLIGHT)


def exact(opened: StudioServer) -> np.ndarray:
    (client,) = opened.server.get_clients().values()
    viewport = opened.page.viewport
    seen = opened.session.display
    return seen.render(camera_of(client), viewport.background).numpy().astype(float)


def wait_for_note(opened: StudioServer, begins: str) -> Callable[[], bool]:
    return lambda: opened.session.state.note.startswith(begins)


def test_pick_paint_compare_undo_save_export(opened: StudioServer, tab: Tab, tmp_path: Path):
    session = opened.session
    until(lambda: "Picked: nothing" in tab.text(), "the page")
    until(lambda: "of all browsers" in tab.text(), "a greeting")
    chooses_pictures(opened, tab, tmp_path)
    before = at_rest(tab, opened)

    until(lambda: draws_no_splats(tab), "frames without splats, which the picture hides")
    hovers(opened, tab)
    draws_cameras(opened, tab, before)
    tab.click(*center_of(opened, "3"))
    until(lambda: session.state.picked == ("3",), "a pick")
    assert_changed(at_rest(tab, opened) - before, opened)

    opened.page.paint.controls["quality"].value = "draft"
    tab.press_button("stripes")
    until(wait_for_note(opened, "Painted 3"), "strokes")
    painted = at_rest(tab, opened)
    assert_changed(painted - before, opened)
    holds(opened, tab, painted)

    tab.press_button("Compare")
    tab.focus_last_slider()
    tab.press("Home")
    until(lambda: session.state.note == "3 at 0%", "intensity 0")
    faded = np.abs(at_rest(tab, opened) - before)
    near = near_object(opened, 3)
    assert faded[~near].max() < 3 * SLIGHT
    assert faded[near].mean() < SLIGHT / 4, "as before, but for JPEG and for refitted splits"

    tab.press_button("undo")
    until(wait_for_note(opened, "Painted 3"), "undo")
    assert np.abs(at_rest(tab, opened) - painted).max() < 3 * SLIGHT
    saved_and_exported(opened, tab, tmp_path / "downloads" / "balls.ply")
    told = tab.page.complaints()
    complaints = [line for line in told if not any(known in line for known in VISERS)]
    assert not complaints, json.dumps(complaints, indent=1)


def draws_no_splats(tab: Tab) -> bool:
    before = tab.page.evaluate("({ ...drawn })")
    tab.page.until(f"drawn.others > {before['others'] + 1}")
    return before["splats"] > 0 and tab.page.evaluate("drawn.splats") == before["splats"]


def chooses_pictures(opened: StudioServer, tab: Tab, folder: Path) -> None:
    """One is too large, one is added; and a part of one is drawn."""
    told, part = list[str](), opened.page.paint.part
    opened.session.on_message.append(lambda line, failure: told.append(line))
    tab.press_button("Paint")
    large, small = folder / "large.png", folder / "plain.png"
    with large.open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    tab.give(large)
    until(lambda: f"Send {MOST_BYTES >> 20} MB at most" in tab.text(), "a refusal")
    assert not told, "the page refused it: nothing was sent"
    Image.new("RGB", (64, 64), (90, 160, 40)).save(small)
    tab.give(small)
    until(lambda: tab.place_of("plain"), "a button for what was added")
    tab.press_button("Settings")
    tab.unfold("Part of a picture", TITLE)
    for start, end, wanted in (
        ((0.2, 0.3), (0.8, 0.5), ((20, 80), (30, 50))),
        ((0.4, 0.4), (0.4, 0.4), ((0, 100), (0, 100))),
        ((0.9, 0.9), (0.1, 0.1), ((10, 90), (10, 90))),
    ):
        tab.drag_on(TITLE, start, end)
        until(lambda wanted=wanted: np.abs(np.subtract(part.percent, wanted)).max() < 2, "a part")


def draws_cameras(opened: StudioServer, tab: Tab, before: np.ndarray) -> None:
    """The photos' cameras lie over the exact picture, which stays where there are none."""
    viewport, session = opened.page.viewport, opened.session
    (client,) = opened.server.get_clients()
    session.ask(lambda: viewport.frames(True))
    assert session.worker.settle()
    until(lambda: viewport.rest.behind and viewport.rest.showing(client), "cameras over a picture")

    def share() -> float:
        height, width = before.shape[:2]
        change = np.abs(tab.page.screenshot()[:height, :width] - before).max(axis=2)
        return float((change > 3 * SLIGHT).mean())

    until(lambda: 0.001 < share() < 0.3, "lines on the exact picture")
    session.ask(lambda: viewport.frames(False))
    assert np.abs(at_rest(tab, opened) - before).max() < 3 * SLIGHT


def hovers(opened: StudioServer, tab: Tab) -> None:
    """The object below the pointer is lit, until the pointer is elsewhere."""
    hover = opened.page.pick.hover
    tab.page.mouse("move", *center_of(opened, "7"))
    until(lambda: [*hover.lit.values()] == ["7"], "an object that is lit")
    tab.page.mouse("move", 2, 2)
    until(lambda: not hover.lit, "nothing to be lit")


def holds(opened: StudioServer, tab: Tab, painted: np.ndarray) -> None:
    """B shows what was before, once for as long as it is held."""
    viewport = opened.page.viewport
    tab.hold("B", True)
    until(lambda: viewport.held, "what was before")
    assert opened.session.worker.settle()
    tab.hold("B", True)  # as a key that is held repeats
    tab.hold("B", False)
    until(lambda: not viewport.held, "the painting again")
    assert np.abs(at_rest(tab, opened) - painted).max() < 3 * SLIGHT


def assert_changed(change: np.ndarray, opened: StudioServer) -> None:
    """The ball is another, and nothing else is."""
    near = near_object(opened, 3)
    assert np.abs(change)[near].mean() > SLIGHT
    assert np.abs(change)[~near].max(initial=0) < 3 * SLIGHT


def saved_and_exported(opened: StudioServer, tab: Tab, file: Path) -> None:
    tab.press_button("Keep")
    tab.press_button("Save")
    until(lambda: not opened.session.unsaved, "saving")
    saved = open(opened.session.folder)
    assert saved.painted_objects == ("3",)
    assert "--region" in tab.text() and "stripes.png" in tab.text()
    tab.press_button("Download")
    until(file.exists, "a download")
    assert len(read_splats(file)) == len(saved.splats)
    tab.press_button("This view as PNG")
    until((file.parent / "view.png").exists, "a picture")
    with Image.open(file.parent / "view.png") as picture:
        assert picture.width == 1920
    tab.press_button("Turntable as MP4")
    until((file.parent / "turntable.mp4").exists, "a video")
    assert b"ftyp" in (file.parent / "turntable.mp4").read_bytes()[:16]


def near_object(opened: StudioServer, id: int) -> np.ndarray:
    """The pixels of a ball, and some around it."""
    (client,) = opened.server.get_clients().values()
    scene = opened.session.state.scene
    camera = camera_of(client)
    seen = coverage(scene.splats, camera, opened.session.masks.of(scene, str(id))) > 0.02
    grown = torch.nn.functional.max_pool2d(seen[None].float(), 2 * FAR + 1, 1, FAR)[0]
    return grown.numpy() > 0
