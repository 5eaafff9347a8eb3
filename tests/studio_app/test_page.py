"""What the page's script tells, and what comes of it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from balls import CAMERAS, SPLATS, enlarged
from browser import quick_style, stripes
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.scene_folder import save
from stylesplat.scene.compose import strengths_of
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.page import MARK, BrowserMessage, parse_message
from stylesplat.studio_app.paint_queue import PaintQueue, warm_up_painting
from stylesplat.studio_app.pick_panel import draw_label
from stylesplat.studio_app.studio import StudioServer, studio

CAMERA = enlarged(CAMERAS, 4)[0]


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[StudioServer]:
    save(Scene(SPLATS, CAMERAS), tmp_path / "balls")
    (tmp_path / "styles").mkdir()
    Image.fromarray(to_uint8(stripes()).numpy()).save(tmp_path / "styles" / "stripes.png")
    found = studio(tmp_path / "balls", styles=tmp_path / "styles", port=0, block=False)
    yield found
    found.close()


def test_only_what_the_script_tells_is_understood():
    text = f'{MARK}{{"number": 3, "before": true, "at": [0.25, 1]}}'
    assert parse_message(text) == BrowserMessage(True, (0.25, 1))
    for bad in ("", "{", '{"at": [2, 0.5]}', '{"at": "here"}', '{"part": [0, 0, 1]}', "[]"):
        assert parse_message(MARK + bad) is None


def test_what_was_before_is_seen_for_as_long_as_anybody_holds_the_key(opened: StudioServer):
    session, viewport = opened.session, opened.page.viewport
    PaintQueue(session, device="cpu").paint(("3",), quick_style(), "stripes")
    assert session.worker.settle() and strengths_of(session.state.scene)
    painted = viewport.look(CAMERA)
    for client, before in ((1, True), (2, True), (2, True), (1, False)):
        viewport.hold(client, before)
    assert session.worker.settle()
    held = viewport.look(CAMERA)
    assert np.abs(held.astype(int) - painted).max() > 50
    viewport.hold(2, False)
    assert session.worker.settle()
    assert np.array_equal(viewport.look(CAMERA), painted)


def test_below_the_pointer_an_object_is_lit_and_named(opened: StudioServer):
    viewport, hover, (width, height) = opened.page.viewport, opened.page.pick.hover, CAMERA.size
    x, y = project(SPLATS.means.new_tensor([[-0.7, 0.0, 0.3]]), CAMERA)[0][0].tolist()
    assert hover.name_at(CAMERA, (x / width, y / height)) == "3"
    assert hover.name_at(CAMERA, (0.0, 0.0)) is None
    red = opened.session.masks.of(opened.session.state.scene, "3")
    plain, lit = viewport.look(CAMERA), viewport.look(CAMERA, red)
    changed = np.abs(lit.astype(int) - plain).max(axis=2) > 8
    assert changed[int(y), int(x)] and changed.mean() < 0.3
    named = draw_label(plain, "3", (width - 2.0, height - 2.0))
    assert named.shape == plain.shape and (named != plain).any()


def test_a_rectangle_that_was_drawn_is_the_part_that_is_painted_with(opened: StudioServer):
    paint = opened.page.paint
    assert paint.part.region((64, 64)) is None
    paint.part.draw((0.25, 0.0, 1.0, 0.5))
    assert opened.session.worker.settle()
    assert paint.part.region((64, 64)) == (16, 0, 64, 32)
    paint.part.draw((0.0, 0.0, 1.0, 1.0))
    assert opened.session.worker.settle() and paint.part.region((64, 64)) is None


def test_what_is_too_large_is_not_kept_while_it_arrives(opened: StudioServer):
    said = list[str]()
    opened.session.on_message.append(lambda line, failure: said.append(line))
    transfers: Any = opened.server.gui._current_file_upload_states
    for name, size, parts in (("a", 30, 60), ("b", 20, 40), ("c", 1, 10**6), ("d", 1, 2)):
        transfers[name] = {"total_bytes": size * 2**20, "part_count": parts, "parts": {}}
    assert [*transfers] == ["a", "d"]
    assert said[0] == "The file has 20 MB. Send 40 MB at most." and len(said) == 2


def test_warming_up_lets_what_is_asked_for_in(opened: StudioServer):
    session, done = opened.session, list[str]()

    def warm() -> None:
        session.worker.ask(lambda: done.append("click"))
        warm_up_painting(session.worker, device="cpu")
        done.append("warm")

    session.ask(warm, patient=True)
    assert session.worker.settle() and done == ["click", "warm"]
