"""The studio in a real browser: pick, paint, compare, undo, save, export."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from balls import CAMERAS, SPLATS, enlarged
from browser import QUICK, Browser, Tab, needs_chromium, studio_tab, until
from stylesplat.io.scene_folder import open, save
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.rendering.weights import coverage
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.edits import recolor_objects
from stylesplat.studio_app.gallery import MOST_BYTES
from stylesplat.studio_app.history import Selected
from stylesplat.studio_app.pictures import camera_of
from stylesplat.studio_app.studio import StudioServer, studio
from stylesplat.stylization.style import Style

pytestmark = [needs_chromium, pytest.mark.usefixtures("quick_painting")]

SIZE = 1100, 700  # pixels of the window
FAR = 8  # pixels around an object to which its strokes may reach
SLIGHT = 12  # of 255: JPEG changes pixels by less


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudioServer]:
    """The balls, and a picture of stripes. What warms up has its own test."""
    monkeypatch.setattr("stylesplat.studio_app.server.WARM_UP_AFTER", 600.0)  # seconds
    folder, styles = tmp_path / "balls", tmp_path / "styles"
    save(Scene(SPLATS, enlarged(CAMERAS[::2], 4)), folder)
    styles.mkdir()
    rows = torch.arange(96) // 6 % 2
    pixels = torch.stack([200 * rows, 90 + 0 * rows, 255 - 200 * rows], dim=-1).to(torch.uint8)
    image = Image.fromarray(pixels[:, None].expand(96, 96, 3).numpy())
    image.save(styles / "stripes.png")
    found = studio(folder, styles=styles, port=0, block=False, device="cpu")
    yield found
    found.close()


@pytest.fixture
def tab(opened: StudioServer, chromium: Browser, tmp_path: Path) -> Iterator[Tab]:
    (tmp_path / "downloads").mkdir()
    with studio_tab(chromium, size=SIZE, downloads=tmp_path / "downloads") as tab:
        tab.session = opened.session
        tab.open(opened.url)
        yield tab


def test_the_whole_way(opened: StudioServer, tab: Tab, tmp_path: Path):
    session = opened.session
    adds_pictures(tab, tmp_path)
    before = settled(tab)
    picks(opened, tab)

    chooses_drafts(tab)
    tab.press_button("Paint like stripes")
    until(lambda: session.state.note == "Painted 3 like stripes", "strokes")
    painted = changed(tab, before)
    assert_changed(painted - before, opened)

    tab.assert_accessible()
    compares(tab, before, painted)
    tab.slide("Strength", 0)
    until(lambda: session.state.note == "Strength of 3: 0%", "strength 0")
    assert_shows(tab, before)
    tab.press_button("Undo: Strength of 3: 0%")
    until(lambda: session.state.note == "Painted 3 like stripes", "undo")
    assert_shows(tab, painted)
    recolors(opened, tab, painted)
    saves_and_exports(opened, tab, tmp_path / "downloads" / "balls.ply")
    tab.open(opened.url)
    assert_shows(tab, painted)  # the same in another tab
    assert "Settings (1)" in tab.text(), "a reload keeps them"
    assert not tab.page.complaints(), json.dumps(tab.page.complaints(), indent=1)


def chooses_drafts(tab: Tab) -> None:
    tab.press_button("Settings")
    tab.page.evaluate("""(() => {
        const field = document.querySelector("dialog select");
        field.value = "draft";
        field.dispatchEvent(new Event("change", { bubbles: true }));
    })()""")
    tab.press_button("Done")


def test_a_variant_is_swapped_by_its_thumbnail(opened: StudioServer, tab: Tab, tmp_path: Path):
    session, queue = opened.session, opened.server.actions.queue
    adds_pictures(tab, tmp_path)
    pictures = opened.server.actions.gallery.pictures

    def paint(name: str, title: str) -> None:
        style = Style(pictures[title].path, config=QUICK)
        session.ask(lambda: queue.paint((name,), style, title))
        until(lambda: session.state.note == f"Painted {name} like {title}", "strokes")

    paint("3", "stripes")
    paint("7", "stripes")
    paint("3", "plain")
    tab.click(*tab.middle_of("3"))
    until(lambda: session.state.picked == ("3",), "a pick")
    before = settled(tab)
    tab.press_button("3: stripes")
    until(lambda: session.state.note == "Switched 3 to stripes", "the other variant")
    assert_changed(changed(tab, before) - before, opened)
    pressed = "document.querySelector('[aria-label=Variants] [aria-pressed=true]').innerText"
    assert tab.page.evaluate(pressed).startswith("stripes\nquality draft")
    tab.press_button("Compare with 3: plain")
    until(lambda: tab.page.evaluate("studio.compared") == "split", "the handle")
    label = "document.querySelector('.cut span').innerText"
    until(lambda: tab.page.evaluate(label) == "3: plain", "the label of what is compared")
    tab.press_button("After")
    tab.press_button("Undo: Switched 3 to stripes")
    assert_shows(tab, before)
    tab.press_button("Name or delete 3: plain")
    tab.assert_accessible()
    tab.press_button("Delete for good")
    until(lambda: len(opened.server.actions.variants) == 2, "one less")


def test_a_style_may_be_clicked_before_the_server_has_told_of_the_pick(
    opened: StudioServer, tab: Tab, tmp_path: Path
):
    session, busy = opened.session, threading.Event()
    adds_pictures(tab, tmp_path)
    where = tab.middle_of("7")
    session.ask(lambda: busy.wait(60))
    tab.click(*where)
    tab.page.until("String(studio.overlay.picked?.names) === '7'")
    tab.press_button("Paint like stripes")
    assert "Pick an object first" not in tab.text()
    busy.set()
    until(lambda: session.painting or session.state.note.startswith("Painted 7"), "a painting")
    session.ask(opened.server.actions.stop)


def test_a_line_that_is_drawn_steers_the_strokes(opened: StudioServer, tab: Tab, tmp_path: Path):
    session, actions = opened.session, opened.server.actions
    adds_pictures(tab, tmp_path)
    style = Style(actions.gallery.pictures["stripes"].path, config=QUICK)
    session.ask(lambda: actions.queue.paint(["7"], style, "stripes"))
    until(lambda: session.state.note == "Painted 7 like stripes", "strokes")
    tab.click(*tab.middle_of("7"))
    until(lambda: session.state.picked == ("7",), "a pick")
    tab.press_button("Draw lines on the paint")
    x, y = tab.middle_of("7")
    tab.assert_accessible()
    tab.drag((x - 12, y), (x + 12, y))
    guides = until(lambda: session.state.scene.layers[0].settings["guides"] or None, "a draft")
    assert len(guides) == 1
    tab.press_button("Let the strokes run as they like")
    until(lambda: not session.state.scene.layers[0].settings["guides"], "no line")
    session.ask(lambda: actions.queue.paint(["7/2"], style, "stripes"))
    until(lambda: session.state.note == "Painted 7/2 like stripes", "a layer above")
    below = session.state.scene.layers[0]
    tab.press_button("Size and direction of the strokes")
    tab.slide("Stroke size", 3)
    until(lambda: session.state.note == "Painted 7/2 like stripes, scale 3", "larger strokes")
    assert session.state.scene.layers[0] is below


def test_another_style_takes_the_place_of_that_on_a_new_layer(
    opened: StudioServer, tab: Tab, tmp_path: Path
):
    session, queue = opened.session, opened.server.actions.queue
    adds_pictures(tab, tmp_path)
    style = Style(opened.server.actions.gallery.pictures["stripes"].path, config=QUICK)
    session.ask(lambda: queue.paint(["7"], style, "stripes"))
    until(lambda: session.state.note == "Painted 7 like stripes", "strokes")
    below = session.state.scene.layers
    tab.click(*tab.middle_of("7"))
    until(lambda: session.state.picked == ("7",), "a pick")
    tab.press_button("New layer")
    chooses_drafts(tab)
    tab.press_button("Paint like stripes")
    until(lambda: session.painting, "a painting")
    tab.press_button("Paint like plain")
    until(lambda: session.state.note == "Painted 7/2 like plain", "the newest")
    assert opened.session.worker.wait_until_idle()
    assert session.state.scene.layers[:-1] == below, "what is below stays"
    tab.press_button("Paint like stripes")
    until(lambda: session.state.note == "Painted 7/2 like stripes", "the layer that is chosen")


def test_layers_are_dragged_and_brushed_out(opened: StudioServer, tab: Tab):
    session = opened.session
    session.do(lambda state: recolor_objects(state, ["3"], "hue", 90.0))
    session.do(lambda state: recolor_objects(state, ["7"], "hue", 90.0))
    below, above = (until(lambda n=n: tab.place_of(f"Move the colours of {n}"), n) for n in "37")
    assert above[1] < below[1], "the highest first"
    tab.click(*tab.middle_of("7"))  # which opens the controls of its layer
    unfolded = "document.querySelector('.layers [aria-expanded=true]')"
    until(lambda: tab.page.evaluate(f"Boolean({unfolded})"), "controls")
    tab.page.mouse("move", *above)
    tab.page.mouse("press", *above)
    tab.page.mouse("move", above[0], above[1] + 9, button="left", buttons=1)
    until(lambda: tab.page.evaluate(f"!{unfolded}"), "no controls between the layers")
    tab.page.mouse("move", below[0], below[1] + 40, button="left", buttons=1)
    tab.page.mouse("release", below[0], below[1] + 40)
    until(lambda: session.state.note == "Moved the recolouring of 7 down", "another order")
    assert [each.name for each in session.state.scene.layers] == ["7/recolor", "3/recolor"]
    until(lambda: session.state.picked == ("7",), "a pick")
    before = settled(tab)
    tab.press_button("Brush the layer out, and in again")
    x, y = tab.middle_of("7")
    tab.drag((x - 12, y), (x + 12, y))
    until(lambda: session.state.note == "Brushed the recolouring of 7 out", "a mask")
    after = changed(tab, before)
    assert session.state.scene.layers[0].mask is not None
    tab.assert_accessible()
    tab.press_button("Undo: Brushed the recolouring of 7 out")
    assert_shows(tab, before)
    tab.press_button("Redo: ")
    assert_shows(tab, after)
    assert not tab.page.complaints(), json.dumps(tab.page.complaints(), indent=1)


def test_a_layer_is_chosen_beside_a_selection_and_where_it_is_of_no_object(
    opened: StudioServer, tab: Tab
):
    session = opened.session
    session.do(lambda state: recolor_objects(state, ["7"], "hue", 90.0))
    session.do(lambda state: recolor_objects(state, ["background"], "hue", 90.0))
    row = "document.querySelectorAll('.layer .card')"
    pick = "document.querySelector('.objects h3').innerText"
    until(lambda: tab.page.evaluate(f"{row}.length") == 2, "two layers")
    tab.press_button("Brush over what is meant")
    x, y = tab.middle_of("7")
    tab.drag((x - 12, y), (x + 12, y))
    until(lambda: tab.page.evaluate(pick) == "Selection", "a selection")
    selection = session.state.selection
    tab.page.evaluate(f"{row}[1].click()")
    tab.press_button("Show the layer within the selection alone")
    until(lambda: session.state.scene.layers[0].mask is not None, "a mask")
    assert selection is not None and session.state.selection is selection
    tab.press_button("Pick objects")
    tab.click(*tab.middle_of("7"))
    until(lambda: tab.page.evaluate(pick) == "7", "a pick")
    tab.page.evaluate(f"{row}[0].click()")
    tab.press_button("Remove the colours of background")
    until(lambda: len(session.state.scene.layers) == 1, "one layer")


def test_a_folder_that_is_dropped_adds_its_pictures_and_tells_of_the_others(
    opened: StudioServer, tab: Tab, tmp_path: Path
):
    folder = tmp_path / "pictures"
    (folder / "more").mkdir(parents=True)
    count = 12
    for number in range(count):
        Image.new("RGB", (64, 64), (20 * number, 90, 40)).save(folder / f"more/{number}.png")
    (folder / "notes.txt").write_text("no picture")
    (folder / "broken.png").write_bytes((folder / "more/0.png").read_bytes()[:60])
    drop(tab, folder)
    until(lambda: f"Added {count} pictures." in tab.text(), "pictures")
    assert "image broken" in tab.text() and "notes" not in tab.text()
    titles = [*opened.server.actions.gallery.pictures]
    added = [title for title in titles if title.isdecimal()]
    assert added == [str(number) for number in range(count)]
    assert tab.place_of(f"Paint like {count - 1}"), "the last one is in sight"
    drop(tab, folder / "notes.txt")
    until(lambda: "image notes" in tab.text(), "a refusal")
    (folder / "empty").mkdir()
    drop(tab, folder / "empty")
    until(lambda: "no picture in what was dropped" in tab.text(), "what is missing")


def drop(tab: Tab, path: Path) -> None:
    """Drop a file or folder of the desktop on the page."""
    data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}
    for what in ("dragEnter", "dragOver", "drop"):
        tab.page.call("Input.dispatchDragEvent", type=what, x=600, y=400, data=data)


def test_an_object_and_a_part_of_a_picture_are_chosen_by_keyboard(opened: StudioServer, tab: Tab):
    session = opened.session
    tab.press_button("7")
    until(lambda: session.state.picked == ("7",), "a pick")
    tab.press_button("Home")
    middle = "studio.overlay.objectAt(...studio.size.map((side) => side / 2))"
    until(lambda: tab.page.evaluate(middle) == "7", "it in the middle")
    tab.press_button("3")
    pick = "document.querySelector('.objects h3').innerText"
    until(lambda: tab.page.evaluate(pick) == "3", "another one")
    tab.wait_until_idle()  # it flies there
    tab.page.evaluate("studio.canvas.focus()")
    tab.key("Enter", True)
    tab.key("Enter", False)
    until(lambda: session.state.picked == ("7",), "the pick in the middle")
    tab.press_button("Choose a part of stripes")
    part = "document.querySelector('.part')"
    until(lambda: tab.page.evaluate("document.querySelector('dialog')?.open"), "the dialog")
    tab.page.evaluate(f"{part}.focus()")
    for key, modifiers in (("ArrowLeft", 8), ("ArrowLeft", 8), ("ArrowRight", 0)):
        tab.key(key, True, modifiers=modifiers)
        tab.key(key, False)
    style = f"{part}.querySelector('i').style"
    until(lambda: tab.page.evaluate(f"parseFloat({style}.left)") > 0, "a part")
    left, wide = (tab.page.evaluate(f"parseFloat({style}.{name})") for name in ("left", "width"))
    assert 0 < left < 10 and 85 < wide < 95 and left + wide < 100
    tab.assert_accessible()


def test_another_click_on_the_surface_takes_another_size(opened: StudioServer, tab: Tab):
    session, at = opened.session, tab.middle_of("7")
    pressed = "document.querySelector('.options [aria-pressed=true]').innerText"
    found = list[Selected]()

    def pick(size: str) -> None:
        def is_new() -> bool:
            now = session.state.selection
            return now is not None and all(now is not each for each in found)

        until(is_new, f"a pick of the size {size}")
        assert session.state.selection is not None
        found.append(session.state.selection)
        until(lambda: tab.page.evaluate("studio.tools.isSpotPicked()"), "the page to know")
        assert tab.page.evaluate(pressed) == size

    tab.press_button("Pick what ends around a click")
    tab.click(*at)
    pick("object")
    tab.press_button("part")
    pick("part")
    for key_down in (True, False):
        tab.key("c", key_down)
    pick("object")
    tab.assert_accessible()
    tab.press_button("Invert")
    until(lambda: session.state.note == "Inverted the selection", "all else")
    name = "document.querySelector('.objects .entry input')"
    until(lambda: tab.page.evaluate(f"{name} && ({name}.value = 'ball')"), "a field for a name")
    tab.press_button("Name it")
    until(lambda: session.state.picked == ("ball",), "an object")
    tab.assert_accessible()
    tab.press_button("Undo: Named the selection ball")
    tab.press_button("Undo: Inverted")
    tab.press_button("Undo: Selected")
    until(lambda: session.state.selection is None, "all three sizes gone by one undo")
    assert not session.state.scene.objects


def test_a_reload_keeps_the_view_and_a_double_click_frames_what_it_hits(
    opened: StudioServer, tab: Tab
):
    tab.click(*tab.middle_of("7"), clickCount=1)
    tab.click(*tab.middle_of("7"), clickCount=2)
    until(lambda: tab.page.evaluate("Boolean(studio.flight)"), "a flight")
    number = "const { ids, names, size } = studio.overlay.map, n = names.indexOf('7') + 1"
    rows = "[...ids.keys()].filter((row) => ids[row] === n).map((row) => Math.floor(row / size[0]))"
    share = f"(() => {{ {number}, r = {rows}; return (r.at(-1) - r[0]) / size[1]; }})()"
    until(lambda: 0.5 < tab.page.evaluate(share) < 0.95, "all of it, as large as fits")
    tab.wait_until_idle()
    place = "JSON.stringify([studio.camera.target, studio.camera.distance])"
    before = tab.page.evaluate(place)
    tab.open(opened.url)
    assert tab.page.evaluate(place) == before
    tab.key("w", True)  # without a click into the picture
    until(lambda: tab.page.evaluate(place) != before, "a step ahead")
    tab.press_button("Pick what looks alike")
    tab.page.evaluate("document.querySelector('.options input[type=range]').focus()")
    tab.wait_until_idle()
    before = tab.page.evaluate(place)
    tab.key("ArrowRight", True)  # the slider's own
    assert tab.page.evaluate(place) == before
    tab.key("w", True)
    assert tab.page.evaluate(place) != before


def test_a_server_that_is_silent_is_told_and_gets_no_clicks_to_do_later(
    opened: StudioServer, tab: Tab, monkeypatch: pytest.MonkeyPatch
):
    fast = "((real) => (f, ms, ...rest) => real(f, ms / 10, ...rest))"
    quick = f"setTimeout = {fast}(setTimeout); setInterval = {fast}(setInterval)"  # ten times
    tab.page.call("Page.addScriptToEvaluateOnNewDocument", source=quick)
    tab.open(opened.url)
    middle, wakes = tab.middle_of("7"), threading.Event()
    blocks = lambda *_: wakes.wait(20)  # noqa: E731 - the thread that answers all pages
    monkeypatch.setattr(opened.server.actions.pictures, "look", blocks)
    tab.page.evaluate("studio.ask(false)")
    until(lambda: "does not answer" in tab.text(), "a word about the server")
    tab.click(*middle)
    until(lambda: "nothing was done" in tab.text(), "a word about the click")
    wakes.set()
    until(lambda: "does not answer" not in tab.text(), "an answer")
    assert opened.session.worker.wait_until_idle()
    assert not opened.session.state.picked
    tab.click(*middle)
    until(lambda: opened.session.state.picked == ("7",), "a pick")


def test_pictures_are_pasted_and_dropped_without_files_and_a_drag_that_goes_leaves_no_hint(
    opened: StudioServer, tab: Tab
):
    pictures = opened.server.actions.gallery.pictures
    tab.page.evaluate("""(async () => {
        const data = async (name, side) => {
            const canvas = new OffscreenCanvas(side, side), found = new DataTransfer();
            canvas.getContext("2d").fillRect(0, 0, side, side);
            const content = [await canvas.convertToBlob()];
            found.items.add(new File(content, `${name}.png`, { type: "image/png" }));
            return found;
        };
        const search = document.querySelector("input[type=search]"), bubbles = true;
        const clipboardData = await data("pasted", 40), dataTransfer = await data("dropped", 50);
        search.dispatchEvent(new ClipboardEvent("paste", { clipboardData, bubbles }));
        search.dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles }));
    })()""")
    until(lambda: {"pasted", "dropped"} <= {*pictures}, "the pictures")
    shows = "getComputedStyle(document.body, '::after').content.includes('Drop pictures')"
    assert not tab.page.evaluate(shows)
    data = {"items": [], "files": [str(opened.session.folder)], "dragOperationsMask": 1}
    for what in ("dragEnter", "dragOver"):
        tab.page.call("Input.dispatchDragEvent", type=what, x=600, y=400, data=data)
    assert tab.page.evaluate(shows)
    tab.page.call("Input.dispatchDragEvent", type="dragCancel", x=0, y=0, data=data)
    until(lambda: not tab.page.evaluate(shows), "no hint")


def test_a_page_goes_on_after_a_restart_once_the_new_address_was_opened(
    opened: StudioServer, tab: Tab
):
    assert tab.page.evaluate("location.href") == f"http://127.0.0.1:{opened.server.port}/"
    tab.page.evaluate("studio.camera.zoom(0.5) || studio.moved()")
    tab.wait_until_idle()
    distance = tab.page.evaluate("(window.isOld = true) && studio.camera.distance")
    middle = tab.middle_of("7")
    opened.close()
    until(lambda: "does not answer" in tab.text(), "a word about the server")
    tab.click(*middle)
    until(lambda: "nothing was done" in tab.text(), "a word about the click")
    assert not tab.page.evaluate("studio.overlay.glow.width && studio.overlay.picked.names.length")
    with restarted(opened) as again:
        assert again.server.port == opened.server.port
        until(lambda: "was started anew" in tab.text(), "a word about the restart")
        assert tab.page.evaluate(f"fetch({again.url!r}).then((answer) => answer.ok)")
        until(lambda: tab.page.evaluate("Boolean(window.studio) && !window.isOld"), "the page")
        assert "was started anew" not in tab.text()
        assert tab.page.evaluate("studio.camera.distance") == distance


def test_the_history_goes_back_to_any_step_after_a_restart_too(opened: StudioServer, tab: Tab):
    before = settled(tab)
    opened.session.do(lambda state: recolor_objects(state, ["3"], "hue", 90.0))
    opened.session.do(lambda state: recolor_objects(state, ["7"], "hue", 90.0))
    pictures = "document.querySelectorAll('.history img').length"
    until(lambda: tab.page.evaluate(pictures) >= 2, "pictures of steps")
    painted = settled(tab)
    opened.close()
    with restarted(opened) as again:
        tab.session = again.session
        tab.open(again.url)
        settled(tab)
        assert_shows(tab, painted)
        tab.press_button("Go to: Opened")
        until(lambda: not again.session.state.scene.layers, "the first step")
        assert_shows(tab, before)
        current = "document.querySelector('.history [aria-current=step]').innerText"
        until(lambda: tab.page.evaluate(current) == "Opened", "the present step")
        tab.assert_accessible()
        tab.press_button("Go to: Recoloured 7: hue 90")
        assert_shows(tab, painted)


@contextmanager
def restarted(opened: StudioServer) -> Iterator[StudioServer]:
    again = studio(opened.session.folder, port=opened.server.port, block=False, device="cpu")
    try:
        yield again
    finally:
        again.close()


def test_keys_are_shown_and_the_first_visit_has_three_hints(opened: StudioServer, tab: Tab):
    assert "1 of 3" in tab.text()
    tab.assert_accessible()
    for button, words in (("Next", "2 of 3"), ("Next", "3 of 3"), ("Start", "")):
        tab.press_button(button)
        until(lambda words=words: words in tab.text(), "the next hint")
    assert "of 3" not in tab.text()
    tab.open(opened.url)
    assert "of 3" not in tab.text()
    tab.key("?", True)
    tab.key("?", False)
    until(lambda: "keep what both have" in tab.text(), "the keys")
    tab.assert_accessible()
    tab.press_button("Close")
    until(lambda: not tab.page.evaluate("Boolean(document.querySelector('dialog'))"), "closed")
    assert not tab.page.complaints(), json.dumps(tab.page.complaints(), indent=1)


def test_two_fingers_move_the_camera_whatever_the_tool(
    opened: StudioServer, chromium: Browser, tmp_path: Path
):
    with studio_tab(chromium, size=(390, 760), downloads=tmp_path) as tab:
        tab.page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        tab.open(opened.url)
        x, y = 200, 360  # below the tools
        tab.press_button("Brush over")
        distance = tab.page.evaluate("studio.camera.distance")

        def touch(kind: str, *places: tuple[float, float]) -> None:
            points = [{"x": x, "y": y, "id": n} for n, (x, y) in enumerate(places)]
            tab.page.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

        touch("touchStart", (x - 20, y))
        touch("touchStart", (x - 20, y), (x + 20, y))
        for wide in (40, 60):
            touch("touchMove", (x - wide, y), (x + wide, y))
        touch("touchEnd")
        assert tab.page.evaluate("studio.camera.distance") < 0.6 * distance
        assert opened.session.worker.wait_until_idle() and not opened.session.state.picked
        tab.press_button("Pick objects")
        tab.press_button("Add")
        for name in ("3", "7"):
            touch("touchStart", tab.middle_of(name))
            touch("touchEnd")
            until(lambda name=name: name in opened.session.state.picked, name)
        assert opened.session.state.picked == ("3", "7"), "without a key"


def changed(tab: Tab, from_: np.ndarray) -> np.ndarray:
    """The next picture, which differs from one before."""

    def picture() -> np.ndarray | None:
        found = tab.picture()
        return found if np.abs(found - from_).max() > 3 * SLIGHT else None

    until(picture, "another picture")
    until(lambda: "Stop" not in tab.text(), "the end of the work")
    return settled(tab)


def settled(tab: Tab) -> np.ndarray:
    """The picture once it stays the same: a coarse one comes before the exact one."""
    if tab.session is not None:
        assert tab.session.worker.wait_until_idle()
    many = 10 if tab.session is None else 3
    pictures = [tab.picture()]

    def same() -> np.ndarray | None:
        pictures.append(tab.picture())
        last = pictures[-many:]
        if len(pictures) > many and np.ptp(np.stack(last), axis=0).max() < 1:
            return last[0]
        return None

    return until(same, "a picture that stays")


def assert_shows(tab: Tab, picture: np.ndarray) -> None:
    """Wait until the page shows a picture again."""
    until(lambda: bool(np.abs(tab.picture() - picture).max() < 3 * SLIGHT), "the same picture")


def adds_pictures(tab: Tab, folder: Path) -> None:
    """One is too large, one is added."""
    large, small = folder / "large.png", folder / "plain.png"
    with large.open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    tab.give(large)
    until(lambda: f"Send {MOST_BYTES >> 20} MB at most" in tab.text(), "a refusal")
    Image.new("RGB", (64, 64), (90, 160, 40)).save(small)
    tab.give(small)
    until(lambda: tab.place_of("Paint like plain"), "a card of what was added")
    tab.page.evaluate("document.querySelectorAll('.notes button').forEach((each) => each.click())")


def picks(opened: StudioServer, tab: Tab) -> None:
    """The object below the pointer is lit and named; clicks and rectangles pick."""
    session, at = opened.session, tab.middle_of("7")
    tab.page.mouse("move", *at)
    until(lambda: tab.page.evaluate("studio.overlay.pointed") == "7", "an object that is lit")
    assert tab.page.evaluate("document.querySelector('.pointed').innerText") == "7"
    tab.click(*at)
    until(lambda: session.state.picked == ("7",), "a pick")
    x, y = tab.middle_of("3")
    tab.drag((x - 60, y - 60), (x + 60, y + 60), modifiers=8)  # Shift
    until(lambda: session.state.picked == ("7", "3"), "another one")
    tab.click(*tab.middle_of("3"))
    until(lambda: session.state.picked == ("3",), "that alone")
    turned = tab.page.evaluate("studio.camera.turned")
    tab.drag((x, y), (x + 40, y))
    assert tab.page.evaluate("studio.camera.turned") != turned
    corner = 320, 90  # where nothing is
    tab.page.mouse("press", *corner)
    for place in ((400, 90), corner):
        tab.page.mouse("move", *place, button="left", buttons=1)
    tab.page.mouse("release", *corner)
    tab.wait_until_idle()
    tab.page.evaluate("studio.camera.reset() || studio.moved()")
    tab.wait_until_idle()
    assert session.worker.wait_until_idle() and session.state.picked == ("3",), "a drag is no click"


def compares(tab: Tab, before: np.ndarray, painted: np.ndarray) -> None:
    """The handle is dragged; B shows what was before for as long as it is held."""
    tab.press_button("Split")
    until(lambda: tab.page.evaluate("studio.shown.before === studio.number"), "both pictures")
    shown = tab.page.evaluate("studio.before.toDataURL('image/png').length")
    assert shown > 1000
    knob = until(lambda: tab.place_of("Border between"), "the handle")
    tab.drag(knob, (knob[0] + 80, knob[1]))
    assert float(tab.page.evaluate("document.querySelector('.knob').ariaValueNow")) > 55
    assert "inset(0" in tab.page.evaluate("studio.before.style.clipPath")
    tab.press_button("After")
    visible = "getComputedStyle(studio.before).visibility"
    assert tab.page.evaluate(visible) == "hidden"
    for down in (True, True, False):  # a key that is held repeats
        tab.key("b", down)
        assert tab.page.evaluate(visible) == ("visible" if down else "hidden")
    tab.key("b", True)
    tab.page.evaluate("dispatchEvent(new Event('blur'))")  # another window is in front
    assert tab.page.evaluate(visible) == "hidden"
    tab.key("b", False)


def recolors(opened: StudioServer, tab: Tab, painted: np.ndarray) -> None:
    """A slider changes the colours of the object alone; undo names it."""
    session = opened.session
    tab.page.evaluate("document.querySelector('details').open = true")
    tab.slide("Hue", 90)
    until(lambda: session.state.note == "Recoloured 3: hue 90", "other colours")
    assert_changed(changed(tab, painted) - painted, opened)
    tab.assert_accessible()
    tab.press_button("Undo: Recoloured 3: hue 90")
    until(lambda: session.state.note == "Painted 3 like stripes", "undo")
    assert_shows(tab, painted)


def assert_changed(change: np.ndarray, opened: StudioServer) -> None:
    """The ball is another, and nothing else is."""
    (look,) = opened.server.actions.pictures.looks.values()
    scene, camera = opened.session.state.scene, camera_of(look)
    seen = coverage(scene.splats, camera, opened.session.masks.of(scene, "3")) > 0.02
    near = torch.nn.functional.max_pool2d(seen[None].float(), 2 * FAR + 1, 1, FAR)[0].numpy() > 0
    assert np.abs(change)[near].mean() > SLIGHT
    assert np.abs(change)[~near].max(initial=0) < 3 * SLIGHT


def saves_and_exports(opened: StudioServer, tab: Tab, file: Path) -> None:
    tab.press_button("Save into")
    until(lambda: not opened.session.unsaved, "saving")
    saved = open(opened.session.folder)
    assert saved.painted_objects == ("3",)
    tab.press_button("Export")
    until(lambda: "recipe.json" in tab.text(), "the command")
    tab.assert_accessible()
    tab.press_button("Download the scene")
    until(file.exists, "a download")
    until(lambda: len(file.read_bytes()) > 1000, "its content")
    assert len(read_splats(file)) == len(saved.splats)


NARROW = 390  # pixels of a telephone's screen
SMALL = """[...document.querySelectorAll("button")]
    .map((each) => [each, each.getBoundingClientRect()])
    .filter(([, box]) => box.width && Math.min(box.width, box.height) < 32)
    .map(([each]) => each.outerHTML)"""
OVERFLOW = """[document.documentElement, document.querySelector(".bar")]
    .map((each) => each.scrollWidth - each.clientWidth)"""
KNOB = "Object.values(document.querySelector('.knob').getBoundingClientRect().toJSON())"


def test_on_a_narrow_screen_everything_can_be_reached(
    opened: StudioServer, chromium: Browser, tmp_path: Path
):
    session = opened.session
    with studio_tab(chromium, size=(NARROW, 760), downloads=tmp_path) as tab:
        tab.open(opened.url)
        session.do(lambda state: recolor_objects(state, ["7"], "hue", 90.0))
        views = "Views", "Keep this view", "Level", "Keep this horizon"
        for label in ("Objects", "Layers", "Styles", *views, "Export"):
            tab.press_button(label)
            tab.assert_accessible()
            assert not tab.page.evaluate(SMALL)
        kept = opened.server.actions.views
        until(lambda: kept.cards()[0].name == "View 1", "the view that is kept")
        assert tab.page.evaluate(OVERFLOW) == [0, 0]
        tab.press_button("Close")
        tab.press_button("Split")
        for end in (0, NARROW - 1):
            x, y = until(lambda: tab.place_of("Border between"), "the handle")
            tab.drag((x, y), (end, y))
            left, _, width, *_ = tab.page.evaluate(KNOB)
            assert 0 <= left and left + width <= NARROW, "it can be dragged back"
        tab.press_button("After")
        tab.click(*tab.middle_of("7"))
        until(lambda: opened.session.state.picked == ("7",), "a pick")

        session.tell("Something failed. Do something else.", failure=True)
        until(lambda: "Something failed" in tab.text(), "a note")
        for width, height in ((844, NARROW), (NARROW, 844), (1280, 800)):
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            tab.page.call("Emulation.setDeviceMetricsOverride", **size)
            note, stage, tools = tab.page.evaluate("""[".notes", ".stage", ".toolbar .tools"]
                .map((each) => document.querySelector(each).getBoundingClientRect().toJSON())""")
            assert stage["left"] <= note["left"] and note["right"] <= stage["right"], width
            beside, below = note["left"] >= tools["right"], note["top"] >= tools["bottom"]
            assert beside or below, "no tool is covered"
