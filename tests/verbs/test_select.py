from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from jaxtyping import Bool

from balls import BALLS, CAMERAS, SPLATS
from capture_files import ColorDetector
from scenes import layer_towards
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import object_record
from stylesplat.scene.scene import Scene
from stylesplat.selection import resolve
from stylesplat.selection.labels import pick, render_labels
from stylesplat.verbs.objects import delete, objects, rename
from stylesplat.verbs.select import select

VIEW = CAMERAS.names[2]
SCENE = Scene(SPLATS, CAMERAS)


def place(id: int) -> tuple[str, float, float]:
    """The middle of a ball in a view."""
    labels = render_labels(SPLATS, CAMERAS[2])
    y, x = (labels == id).nonzero().median(dim=0).values.tolist()
    return VIEW, float(x), float(y)


def found_ids(scene: Scene = SCENE, **choice: Any) -> tuple[int, ...]:
    """The label ids that a selection means."""
    return select(scene, "it", **choice).objects["it"].selection.ids


def picked(scene: Scene, name: str) -> Bool[torch.Tensor, " N"]:
    return scene.objects[name].mask


def test_points_are_united_but_for_those_that_are_not_meant():
    assert found_ids(point=[place(3), place(7)]) == (3, 7)
    assert found_ids(id=(3, 7, 300), not_point=place(7)) == (3, 300)
    with pytest.raises(StyleSplatError, match="--not-point only excludes"):
        select(SCENE, "none", id=7, not_point=place(7))
    box = (-3.0, -3.0, 0.02, 3.0, 3.0, 3.0)
    found = select(SCENE, "all but green", box3d=box, not_point=place(7))
    assert not (picked(found, "all but green") & pick(SPLATS, object_id=7)).any()


def test_union_and_difference_of_earlier_selections():
    scene = SCENE
    for id, name in ((3, "red"), (7, "green")):
        scene = select(scene, name, id=id)
    scene = select(scene, "both", plus=("red", "green"))
    scene = select(scene, "rest", plus="both", minus="red")
    assert torch.equal(picked(scene, "both"), picked(scene, "red") | picked(scene, "green"))
    assert torch.equal(picked(scene, "rest"), picked(scene, "green"))
    with pytest.raises(StyleSplatError, match="Nothing is left of the selection"):
        select(scene, "none", plus="red", minus="both")
    with pytest.raises(StyleSplatError, match="no object 'blue'"):
        select(scene, "x", plus="blue")


def test_a_scene_is_never_changed(said: list[str]):
    once = select(SCENE, "it", id=3)
    assert said == []
    twice = select(once, "it", id=7)
    assert said == [f"'it' meant {picked(once, 'it').sum()} Gaussians before."]
    assert not SCENE.objects and [*twice.objects] == ["it"]
    assert torch.equal(picked(once, "it"), pick(SPLATS, object_id=3))
    assert torch.equal(picked(twice, "it"), pick(SPLATS, object_id=7))


def test_several_shapes_are_united():
    spheres = [(*BALLS[id][0], 0.31) for id in (3, 7)]
    scene = select(SCENE, "balls", sphere=spheres)
    for name, sphere in zip(("red", "green"), spheres, strict=True):
        scene = select(scene, name, sphere=sphere)
        inside = (SPLATS.means - torch.tensor(sphere[:3])).norm(dim=1) < 0.31
        assert torch.equal(picked(scene, name), inside)
    assert torch.equal(picked(scene, "balls"), picked(scene, "red") | picked(scene, "green"))
    records = {name: object_record(each) for name, each in scene.objects.items()}
    assert records["balls"]["sphere"] == tuple(("", each) for each in spheres)
    assert records["red"]["sphere"] == ("", spheres[0]), "one is written as it was"


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"point": (1.0, 2.0)}, r"Cannot use point=\(1.0, 2.0\)\. Give \(view, x, y\)"),
        ({"box": (VIEW, 1, 2, 3)}, r"Give \(view, x0, y0, x1, y1\)"),
        ({"sphere": [(1.0, 2.0, 3.0, 4.0), (1.0,)]}, r"Cannot use sphere=\(1.0,\)"),
        ({"sphere": (VIEW, 1.0, 2.0)}, r"Give \(x, y, z, radius\) or \(view, x, y, radius\)"),
        ({"box3d": (1.0, 2.0, 3.0)}, r"Cannot use box3d=\(1.0, 2.0, 3.0\)\. Give \(x0"),
        ({"point": ("lost.jpg", 1, 2)}, "No view is called 'lost.jpg'"),
    ],
)
def test_places_that_are_none(choice: dict[str, Any], message: str):
    with pytest.raises(StyleSplatError, match=message):
        select(SCENE, "it", **choice)


def test_grow_and_shrink_come_last():
    scene = select(SCENE, "more", id=(3, 7), not_point=place(7), grow=0.2)
    red, green = (pick(SPLATS, object_id=id) for id in (3, 7))
    grown = picked(scene, "more")
    assert grown[red].all() and not grown[green].any(), "what was taken stays away"
    assert grown.sum() > red.sum(), "the table under it is taken in"
    scene = select(scene, "less", plus="more", shrink=0.05)
    assert scene.objects["less"].selection.shrink == 0.05
    assert 0 < picked(scene, "less").sum() < grown.sum()
    listed = {each["id"]: each["names"] for each in objects(select(scene, "red", id=3))}
    assert listed[3] == ["red"], "a grown name is not that of the object"


def test_grow_or_shrink_that_cannot_be():
    with pytest.raises(StyleSplatError, match="Pass --grow or --shrink"):
        select(SCENE, "x", id=3, grow=0.1, shrink=0.1)
    for share in (0.0, float("nan"), 2.0):
        with pytest.raises(StyleSplatError, match="at most 1"):
            select(SCENE, "x", id=3, grow=share)
    with pytest.raises(StyleSplatError, match="Shrink it less"):
        select(SCENE, "x", id=3, shrink=1.0)
    with pytest.raises(StyleSplatError, match="Select with --id, --point"):
        select(SCENE, "x")


@pytest.fixture
def detector(monkeypatch: pytest.MonkeyPatch) -> ColorDetector:
    detector = ColorDetector()
    monkeypatch.setattr(resolve, "load_detector", lambda model, device: detector)
    return detector


def test_by_text(detector: ColorDetector):
    scene = select(SCENE, "it", text="the red one")
    found = scene.objects["it"].selection
    assert found.ids == (3,) and found.text == ("the red one",)
    assert found.scores.keys() == {3} and 0.5 < found.scores[3] < 0.81
    assert torch.equal(picked(scene, "it"), pick(SPLATS, object_id=3))
    assert found_ids(id=7, text="red") == (7, 3), "it is united with the rest"


def test_text_that_means_nothing_or_several(detector: ColorDetector):
    with pytest.raises(StyleSplatError, match="No object of the scene fits 'owl'"):
        select(SCENE, "it", text="owl")
    with pytest.raises(StyleSplatError, match="The text is empty"):
        select(SCENE, "it", text=" ")
    with pytest.raises(StyleSplatError, match=r"may mean several objects.* 3 \(0.*--id"):
        select(SCENE, "it", text="red or green")


def test_text_is_about_how_things_looked_before_styling(detector: ColorDetector):
    """A red ball that was painted green is still the red one."""
    painted = SPLATS.sh0.clone()
    assert SPLATS.identities is not None
    red, green = (SPLATS.identities[:, column] == 1 for column in (1, 2))
    painted[red], painted[green] = SPLATS.sh0[green], SPLATS.sh0[red]
    splats = replace(SPLATS, sh0=painted)
    layer = layer_towards(SPLATS, splats, red | green, "3")
    styled = Scene(SPLATS, CAMERAS).with_layers([layer])
    assert found_ids(styled, text="red") == (3,)


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("", "must not be empty"),
        ("3", "numbers are label ids"),
        ("a=b", "must not contain '=', slashes or control characters"),
        ("\ud800", "must not contain"),
        ("__metadata__", "use that name for themselves"),
        ("x" * 101, "at most 100 characters"),
    ],
)
def test_names_that_cannot_be_kept_are_refused(name: str, fault: str):
    with pytest.raises(StyleSplatError, match=fault) as caught:
        select(SCENE, name, id=3)
    line = str(caught.value)
    assert line.startswith("Cannot call an object '") and line.endswith(". Choose another name.")
    assert len(line) < 200 and line.isprintable()


def test_places_are_checked_before_a_model_is_loaded(tmp_path: Path):
    missing = str(tmp_path / "no model")
    with pytest.raises(StyleSplatError, match=r"lost\.jpg"):
        select(SCENE, "it", text="owl", model=missing, not_point=("lost.jpg", 1, 2))
    with pytest.raises(StyleSplatError, match="9999"):
        select(SCENE, "it", text="owl", model=missing, box=(VIEW, 0, 0, 9999, 9))


def red_and_cap(**choice: Any) -> tuple[Scene, Bool[torch.Tensor, " N"]]:
    """The red ball, and a part of it that is chosen by the upper half of its box."""
    scene = select(SCENE, "red", id=3)
    x, y, z = BALLS[3][0]
    box = (x - 1, y - 1, z + 0.1, x + 1.5, y + 1, z + 1)  # reaches over the green ball, too
    return select(scene, "cap", **({"of": "red", "box3d": box} | choice)), picked(scene, "red")


def test_a_part_leaves_its_object_the_rest():
    scene, whole = red_and_cap()
    cap, rest = picked(scene, "cap"), picked(scene, "red")
    assert cap.any() and rest.any()
    assert torch.equal(cap | rest, whole) and not (cap & rest).any()
    assert object_record(scene.objects["red"])["gaussians"] == rest.sum()
    assert objects(scene)[0]["names"] == [], "it is not the whole object of the label any more"
    x, y, z = BALLS[3][0]
    side = (x, y, z + 0.3, 0.2)
    smaller = select(scene, "cap", of="red", sphere=side)
    cap, rest = picked(smaller, "cap"), picked(smaller, "red")
    assert torch.equal(cap | rest, whole) and not (cap & rest).any(), "made again"
    grown = select(scene, "cap", of="red", sphere=side, grow=0.3)
    assert not (picked(grown, "cap") & ~whole).any()
    renamed = rename(scene, "red", "pot")
    assert torch.equal(picked(delete(renamed, "cap"), "pot"), whole), "it is given back"


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"of": "green"}, "no object 'green'"),
        ({"of": "cap"}, "'cap' is no part of itself"),
        ({"box3d": (), "sphere": (*BALLS[3][0], 0.5)}, "all of 'red', not a part"),
        ({"box3d": (), "id": 7}, r"belongs to 'red'; no other.*--of.*--minus"),
    ],
)
def test_parts_that_are_none(choice: dict[str, Any], message: str):
    with pytest.raises(StyleSplatError, match=message):
        red_and_cap(**choice)
