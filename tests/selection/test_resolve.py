"""Selections that are resolved again, and what is left beside objects."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS
from capture_files import ColorDetector
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import IN_MEMORY, Selection
from stylesplat.selection import resolve
from stylesplat.selection.resolve import resolve_selection
from stylesplat.verbs.objects import objects
from stylesplat.verbs.select import select

TABLE = torch.arange(len(SPLATS)) < 200
SCENE = Scene(SPLATS, CAMERAS)
PLAIN = Scene(replace(SPLATS, identities=None, classifier=None), CAMERAS)
BOX = (-1.1, -0.4, 0.02, -0.3, 0.4, 0.7)  # around the red ball


def picked(scene: Scene, name: str) -> torch.Tensor:
    return scene.objects[name].mask


def test_the_background_is_what_no_label_id_has():
    """Strays of objects are not it, nor does it matter what has a name."""
    scene = select(SCENE, "part of it", box3d=(-3.0, -3.0, -1.0, 0.0, 3.0, 0.01))
    scene = select(scene, "table", background=True)
    assert torch.equal(picked(scene, "table"), TABLE)
    assert scene.objects["table"].selection.background
    half = select(scene, "half", background=True, minus="part of it")
    assert torch.equal(picked(half, "half"), TABLE & ~picked(scene, "part of it"))
    more = select(scene, "more", background=True, id=3)
    assert picked(more, "more").sum() > 270
    assert {each["id"]: each["names"] for each in objects(more)}[3] == []


def test_without_label_ids_it_is_what_has_no_name():
    scene = select(PLAIN, "red", box3d=BOX)
    scene = select(scene, "rest", background=True)
    assert torch.equal(picked(scene, "rest"), ~picked(scene, "red"))
    for name in ("rest", "again"):  # a background is no object beside itself
        found = select(scene, name, background=True)
        assert torch.equal(picked(found, name), picked(scene, "rest"))
    scene = select(scene, "green", box3d=(0.3, -0.4, 0.02, 1.1, 0.4, 0.7))
    found = select(scene, "red", background=True)
    assert torch.equal(picked(found, "red"), ~picked(scene, "green")), "nor what it is called"


def test_no_background():
    with pytest.raises(StyleSplatError, match=r"all of it is background\. Select it with"):
        select(PLAIN, "it", background=True)
    scene = select(PLAIN, "all of it", box3d=(-9.0, -9.0, -9.0, 9.0, 9.0, 9.0))
    with pytest.raises(StyleSplatError, match="Nothing is background"):
        select(scene, "it", background=True)


VIEW = CAMERAS.names[2]
IN_RED = torch.arange(len(SPLATS)) % 7 == 0


def pixel(id: int) -> tuple[str, float, float]:
    """The middle of a ball in a view."""
    x, y = project(torch.tensor([BALLS[id][0]]), CAMERAS[2])[0][0].tolist()
    return VIEW, x, y


def around(id: int) -> tuple[str, float, float, float, float]:
    view, x, y = pixel(id)
    return view, x - 2, y - 2, x + 2, y + 2


def rows_file(folder: Path) -> dict[str, Any]:
    np.save(folder / "rows.npy", IN_RED.numpy())
    return {"rows": folder / "rows.npy"}


PICKS: dict[str, dict[str, Any] | Callable[[Path], dict[str, Any]]] = {
    "ids": {"id": (3, 7), "threshold": 0.9, "remove_outliers": False},
    "box": {"box": around(3)},
    "point": {"point": [pixel(3), pixel(7)]},
    "not a point": {"id": (3, 7, 300), "not_point": pixel(7)},
    "on the surface": {"point": pixel(3), "not_point": pixel(7), "size": "part"},
    "text": {"text": "the red one", "model": "a/b"},
    "texts": {"id": 7, "text": ["the red one", "blue"]},
    "box3d": {"box3d": BOX},
    "boxes3d": {"box3d": [BOX, (0.3, -0.4, 0.02, 1.1, 0.4, 0.7)]},
    "sphere": {"sphere": (*BALLS[3][0], 0.31)},
    "sphere in a view": {"sphere": [(*pixel(3), 0.4), (*BALLS[7][0], 0.31)]},
    "rows": rows_file,
    "a mask": {"rows": IN_RED},
    "plus and minus": {"plus": ("part", "7"), "minus": "red"},
    "part": {"of": "red", "box3d": BOX},
    "all": {"all": True, "minus": "red"},
    "background": {"background": True, "id": 3},
    "grown": {"id": 3, "grow": 0.2},
    "shrunk": {"plus": "red", "shrink": 0.05},
}


@pytest.mark.parametrize("name", PICKS)
def test_a_selection_is_kept_and_found_again(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """In JSON, and in `objects.json`, whose keys are the fields."""
    monkeypatch.setattr(resolve, "load_detector", lambda *_: ColorDetector())
    choice = PICKS[name]
    given = choice(tmp_path) if callable(choice) else choice
    before = select(select(SCENE, "red", id=3), "part", box3d=(-0.9, -0.4, 0.3, -0.3, 0.4, 0.7))
    if name == "part":
        before = select(before, "red", plus="red", grow=0.3)
    scene = select(before, "it", **given)
    found = scene.objects["it"]
    assert 0 < found.mask.sum() < len(SPLATS)
    kept = msgspec.json.decode(msgspec.json.encode(found.selection), type=Selection)
    assert kept == found.selection
    mask = IN_RED if kept.rows == IN_MEMORY else None
    again = resolve_selection(before, kept, name="it", mask=mask)
    assert again.selection == kept and torch.equal(again.mask, found.mask)
    scene_folder.save(scene, tmp_path / "scene")
    assert scene_folder.open(tmp_path / "scene").objects["it"].selection == kept
