"""Scenes on disk: as they were in memory, or damaged."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from scenes import COUNT, assert_same, contents, full_scene, plain_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.scene_folder import revise
from stylesplat.io.splats.splat_ply import write_splat_ply
from stylesplat.io.tensors import write_tensors
from stylesplat.scene.layers import compose
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import IN_MEMORY, Selection
from stylesplat.scene.splats import Splats


@pytest.mark.parametrize("make", [plain_scene, full_scene])
def test_round_trip(tmp_path: Path, make: Callable[[], Scene]):
    scene = make()
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_what_is_read_composes_to_the_same(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    found = scene_folder.open(tmp_path / "scene")
    composed = compose(found.base, found.layers).splats
    for name, tensor in found.splats.tensors().items():
        assert torch.equal(tensor, composed.tensors()[name]), name
    bare = found.without_layers()
    scene_folder.save(bare, tmp_path / "scene", overwrite=True)
    assert_same(scene_folder.open(tmp_path / "scene"), bare)


def test_two_objects_of_one_mask(tmp_path: Path):
    scene = full_scene().without_layers()
    scene = replace(scene, objects={**scene.objects, "again": scene.objects["fox"]})
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_the_deepest_relief_that_painting_measures(tmp_path: Path):
    scene = full_scene()
    layers = [replace(layer, relief=layer.relief * 0 - 2) for layer in scene.layers]
    scene = scene.with_layers(layers)
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_the_files_of_a_scene(tmp_path: Path):
    scene_folder.save(plain_scene(), tmp_path / "plain")
    scene_folder.save(full_scene(), tmp_path / "full")
    plain = {"scene.json", "splats.ply", "cameras.json", "objects.json", "picks.safetensors"}
    plain.add("metrics.json")
    assert {p.name for p in (tmp_path / "plain").iterdir()} == plain
    styled = {"identities.safetensors", "base.ply", "layers", "layers.json", "recipe.json"}
    assert {p.name for p in (tmp_path / "full").iterdir()} == plain | styled
    files = {"01-fox.safetensors", "02-7.safetensors", "03-Br_cke.safetensors"}
    assert {p.name for p in (tmp_path / "full/layers").iterdir()} == files
    stack = json.loads((tmp_path / "full/layers.json").read_text())["layers"]
    assert [each["object"] for each in stack] == ["fox", "7", "Brücke"]
    assert [(each["strength"], each["visible"]) for each in stack[::2]] == [(0.7, True), (1, False)]


def test_no_scene(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"is an empty folder, not a scene: it has no scene"):
        scene_folder.open(tmp_path)
    (tmp_path / "notes.txt").touch()
    with pytest.raises(StyleSplatError, match=r"is a folder, not a scene: it has no scene.json"):
        scene_folder.open(tmp_path)
    with pytest.raises(StyleSplatError, match="not a scene"):
        revise(plain_scene(), plain_scene(), tmp_path)


@pytest.mark.parametrize("edit", [lambda splats: splats[:6], lambda splats: splats.map(torch.neg)])
def test_a_splat_that_was_edited_is_refused_and_moved_away(
    edit: Callable[[Splats], Splats], tmp_path: Path
):
    """Else it would be ignored silently: what a scene shows is composed."""
    scene_folder.save(full_scene(), tmp_path / "scene")
    path = tmp_path / "scene/splats.ply"
    write_splat_ply(edit(full_scene().splats), path)
    with pytest.raises(StyleSplatError, match=r"splats\.ply is not .*--like"):
        scene_folder.open(tmp_path / "scene")
    path.rename(tmp_path / "edited.ply")
    assert_same(scene_folder.open(tmp_path / "scene"), full_scene())


def test_an_object_of_surfels_alone_gets_their_parents(tmp_path: Path):
    """As earlier versions wrote them."""
    scene = full_scene()
    scene_folder.save(scene, tmp_path / "scene")
    picks = {name: scene.to_splats(each.mask) for name, each in scene.objects.items()}
    picks["fox"] = torch.arange(len(scene.splats)) == COUNT
    write_tensors(picks, tmp_path / "scene/picks.safetensors")
    (row,) = scene_folder.open(tmp_path / "scene").objects["fox"].mask.nonzero()[:, 0]
    assert row == scene.layers[0].parents[0]


RECORDS: dict[str, tuple[dict[str, Any], Selection]] = {  # of versions before `Selection`
    "label": ({"ids": [7], "threshold": 0.7}, Selection(ids=(7,), threshold=0.7)),
    "clicked": (
        {"ids": [7], "points": [["a.jpg", [1.5, 2]]], "not_points": [["a.jpg", [3, 4]]]},
        Selection(ids=(7,), points=(("a.jpg", (1.5, 2)),), not_points=(("a.jpg", (3, 4)),)),
    ),
    "boxed": ({"boxes": [["a.jpg", [1, 2, 3, 4]]]}, Selection(boxes=(("a.jpg", (1, 2, 3, 4)),))),
    "named": (
        {"ids": [7], "text": "fox", "scores": {"7": 0.5}},
        Selection(ids=(7,), text=("fox",), scores={7: 0.5}),
    ),
    "either": ({"text": ["fox", "dog"]}, Selection(text=("fox", "dog"))),
    "box": ({"box3d": [1, 2, 3, 4, 5, 6]}, Selection(box3d=((1, 2, 3, 4, 5, 6),))),
    "ball": ({"sphere": ["", [1, 2, 3, 4]]}, Selection(sphere=(("", (1, 2, 3, 4)),))),
    "balls": (
        {"sphere": [["", [1, 2, 3, 4]], ["a.jpg", [1, 2, 3]]]},
        Selection(sphere=(("", (1, 2, 3, 4)), ("a.jpg", (1, 2, 3)))),
    ),
    "mask": ({"ids": [], "rows": ["a mask"]}, Selection(rows=IN_MEMORY)),
    "part": (
        {"of": "fox", "size": "part", "plus": ["a", "b"], "minus": ["c"], "grow": 0.1},
        Selection(of="fox", size="part", plus=("a", "b"), minus=("c",), grow=0.1),
    ),
    "rest": ({"background": True, "shrink": 0.1}, Selection(background=True, shrink=0.1)),
    "all": ({"all": True}, Selection(all=True)),
}


def test_what_was_selected_before_is_known(tmp_path: Path):
    """And keys of other programs stay where they are."""
    mask = torch.arange(COUNT) < 3
    objects = {name: SceneObject(mask.clone()) for name in RECORDS}
    scene = replace(plain_scene(), objects=objects)
    scene_folder.save(scene, tmp_path / "scene")
    path = tmp_path / "scene/objects.json"
    records = {name: {**record, "gaussians": 3} for name, (record, _) in RECORDS.items()}
    path.write_text(json.dumps(records | {"all": {**records["all"], "note": "mine"}}))
    found = scene_folder.open(tmp_path / "scene")
    assert {name: each.selection for name, each in found.objects.items()} == {
        name: selection for name, (_, selection) in RECORDS.items()
    }
    revise(found, found.with_object("box", SceneObject(~mask)), tmp_path / "scene")
    written = json.loads(path.read_text())
    for name, record in records.items():
        if name != "box":
            same = {key: written[name][key] for key in record}
            assert same == record, "as earlier versions wrote it"
    assert written["all"]["note"] == "mine" and "box3d" not in written["box"]


def test_identities_that_were_not_lifted_have_no_confidence(tmp_path: Path):
    scene = full_scene().without_layers()
    scene = replace(scene, base=replace(scene.base, confidence=None))
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def camera_with(**changes: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, cameras=replace(scene.cameras, **changes))


def splats_with(name: str, value: float) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        tensor = getattr(scene.base, name).clone()
        tensor[0] = value
        return replace(scene, base=replace(scene.base, **{name: tensor}))

    return changed


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (camera_with(names=("a\nb.png", "c.png")), "name"),
        (camera_with(names=("a.png", "a.png")), "the same name"),
        (camera_with(sizes=torch.tensor([[70_000, 9], [8, 9]])), "65535"),
        (camera_with(viewmats=torch.zeros(2, 4, 4)), "viewmat"),
        (splats_with("opacities", math.inf), "opacities are not finite"),
        (splats_with("means", 1e30), "means are out of range"),
        (splats_with("quats", 0.0), "rotations of 1 Gaussians are 0"),
    ],
    ids=range(7),
)
def test_what_could_not_be_opened_never_replaces_a_scene(
    change: Callable[[Scene], Scene], told: str, tmp_path: Path
):
    scene_folder.save(full_scene(), tmp_path / "scene")
    before = contents(tmp_path / "scene")
    with pytest.raises(StyleSplatError, match=told):
        scene_folder.save(change(full_scene()), tmp_path / "scene", overwrite=True)
    assert contents(tmp_path / "scene") == before
