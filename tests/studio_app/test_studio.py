import socket
import threading
from dataclasses import replace
from pathlib import Path
from typing import cast
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
import torch

from balls import CAMERAS, SPLATS
from browser import QUICK, stripes
from processes import LIMIT, needs_permissions, read_only
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import open, save
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.studio_app.history import replace_scene
from stylesplat.studio_app.selecting import pick_names, rename_picked
from stylesplat.studio_app.studio import studio
from stylesplat.stylization.style import Style

LONG = replace(QUICK, steps=5000)  # longer than any test


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save(Scene(SPLATS, CAMERAS), tmp_path / "balls")
    return tmp_path / "balls"


def test_closing_keeps_what_is_not_saved_and_opening_goes_on_with_it(folder: Path, said: list[str]):
    opened = studio(folder, port=0, block=False)
    opened.session.do(lambda state: rename_picked(pick_names(state, ["3"]), "red"))
    assert opened.session.worker.wait_until_idle()
    opened.close()
    assert "Not saved, but kept" in said[-1]
    assert not open(folder).objects, "the scene itself is as it was"
    again = studio(folder, port=0, block=False)
    try:
        assert [*again.session.state.scene.objects] == ["red"] and again.session.unsaved
        assert "Recovered" in said[-1]
        again.session.step(-1)
        assert again.session.worker.wait_until_idle()
        assert not again.session.state.scene.objects
    finally:
        again.close()


def test_closing_keeps_what_there_is_of_a_painting(folder: Path):
    opened = studio(folder, port=0, block=False, device="cpu")
    strokes, queue = threading.Event(), opened.server.actions.queue

    def look() -> None:
        if opened.session.progress is not None and opened.session.progress.share > 0:
            strokes.set()

    opened.session.on_change.append(look)
    opened.session.ask(lambda: queue.paint(("3",), Style(stripes(), config=LONG), "stripes"))
    assert strokes.wait(LIMIT)
    opened.close()
    again = studio(folder, port=0, block=False)
    try:
        kept = again.session.state.scene
        assert kept.painted_objects == ("3",)
        assert not torch.equal(kept.splats.sh0, SPLATS.sh0)
    finally:
        again.close()


def test_a_failure_at_closing_is_told_and_the_studio_is_closed(folder: Path, said: list[str]):
    opened = studio(folder, port=0, block=False)
    number, no_json = opened.server.port, Selection(scores={3: cast("float", object())})
    opened.session.do(
        lambda state: replace_scene(
            state,
            replace(state.scene, objects={"red": SceneObject(SPLATS.means[:, 0] > 0, no_json)}),
            "an object that no file can hold",
        )
    )
    assert opened.session.worker.wait_until_idle()
    with pytest.raises(TypeError):
        opened.close()
    assert "something may be lost: TypeError" in said[-1]
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", number)) != 0


@needs_permissions
def test_where_nothing_can_be_written_save_says_so_and_all_else_works(
    tmp_path: Path, said: list[str]
):
    save(Scene(SPLATS, CAMERAS), tmp_path / "balls")
    with read_only(tmp_path, tmp_path / "balls"):
        opened = studio(tmp_path / "balls", port=0, block=False)
        opened.session.do(lambda state: rename_picked(pick_names(state, ["3"]), "red"))
        assert opened.session.worker.wait_until_idle()
        assert [*opened.session.state.scene.objects] == ["red"]
        assert opened.store is not None
        with pytest.raises(StyleSplatError, match="Cannot write"):
            opened.store.save()
        with pytest.raises(StyleSplatError, match="Cannot write"):
            opened.store.save_as("other")
        opened.close()
    assert "Cannot keep the history" in said[-1]
    assert not open(tmp_path / "balls").objects


def test_the_user_is_warned_of_the_network(folder: Path, said: list[str]):
    studio(folder, port=0, block=False).close()
    assert not said
    opened = studio(folder, port=0, host="0.0.0.0", block=False)
    try:
        assert "0.0.0.0 is open to the network" in said[-1] and str(folder) in said[-1]
        assert "//0.0.0.0" not in opened.url
        with urlopen(opened.url, timeout=LIMIT) as answer:
            assert answer.status == 200, "the address that is printed works"
        elsewhere = Request(opened.url.partition("?")[0], headers={"Host": "evil.example"})
        with pytest.raises(HTTPError, match="403") as refused:
            urlopen(elsewhere, timeout=LIMIT)
        assert b"opened there with the token" in refused.value.read()
    finally:
        opened.close()


def test_what_cannot_be_opened_is_told_before_anything_is_served(tmp_path: Path, folder: Path):
    with pytest.raises(StyleSplatError, match="empty"):
        studio(Scene(SPLATS[torch.arange(0)], CAMERAS, path=folder), block=False)
    with pytest.raises(StyleSplatError, match="no folder to save to"):
        studio(replace(open(folder), path=None), block=False)
    with pytest.raises(StyleSplatError, match="no folder"):
        studio(folder, styles=tmp_path / "none", block=False)
    with pytest.raises(StyleSplatError):
        studio(tmp_path / "nothing", block=False)
