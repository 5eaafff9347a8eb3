"""Everything, and what is left of it beside objects."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.scene.scene import Scene
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
    assert scene.objects["table"].how["background"] is True
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
