"""Scenes on disk: as they were in memory, or damaged."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load, save

from full_scenes import COUNT, assert_same, full_scene, painted, plain_scene, random
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.scene_folder import revise
from stylesplat.scene.paintings import Unsplit
from stylesplat.scene.scene import Scene


@pytest.mark.parametrize("make", [plain_scene, full_scene])
def test_round_trip(tmp_path: Path, make: Callable[[], Scene]):
    scene = make()
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_without_higher_bands_all_else_is_the_same(tmp_path: Path):
    scene = full_scene()
    scene_folder.save(scene, tmp_path / "scene")
    bare = replace(scene, splats=replace(scene.splats, shN=scene.splats.shN[:, :0]))
    assert_same(scene_folder.open_without_bands(tmp_path / "scene"), bare)


def test_what_undoes_a_split_comes_back(tmp_path: Path):
    shape = Unsplit(4, torch.tensor([0, 3]), random(2, 3), random(2))
    split = replace(full_scene(), painted=replace(painted(), unsplit=shape))
    scene_folder.save(split, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), split)
    scene_folder.save(full_scene(), tmp_path / "scene", overwrite=True)
    assert_same(scene_folder.open(tmp_path / "scene"), full_scene())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_cameras_are_exact(tmp_path: Path, dtype: torch.dtype):
    scene = plain_scene(dtype)
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_the_files_of_a_scene(tmp_path: Path):
    scene_folder.save(plain_scene(), tmp_path / "plain")
    scene_folder.save(full_scene(), tmp_path / "full")
    plain = {"scene.json", "splats.ply", "cameras.json", "objects.json", "picks.safetensors"}
    plain.add("metrics.json")
    assert {p.name for p in (tmp_path / "plain").iterdir()} == plain
    styled = {"base_colors.safetensors", "style_colors.safetensors", "paintings.safetensors"}
    assert {p.name for p in (tmp_path / "full").iterdir()} == plain | styled | {
        *("identities.safetensors", "opacities.safetensors", "recipe.json")
    }


def test_base_colors_have_the_bands_that_the_splats_get(tmp_path: Path):
    scene, colors = full_scene(), painted().before
    few = replace(painted(), before=replace(colors, shN=colors.shN[:, :3]))
    scene_folder.save(replace(scene, painted=few), tmp_path / "scene")
    found = scene_folder.open(tmp_path / "scene")
    assert found.painted is not None
    assert found.painted.before.shN.shape == found.splats.shN.shape
    assert torch.equal(found.painted.before.shN[:, :3], colors.shN[:, :3])


def test_the_folder_that_it_was_opened_from(tmp_path: Path):
    scene_folder.save(plain_scene(), tmp_path / "scene")
    assert scene_folder.open(tmp_path / "scene").path == tmp_path / "scene"


def test_a_scene_is_not_overwritten_by_accident(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    with pytest.raises(
        StyleSplatError, match=r"holds an earlier result.*`--overwrite`.*overwrite=True"
    ):
        scene_folder.save(plain_scene(), tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), full_scene())
    scene_folder.save(plain_scene(), tmp_path / "scene", overwrite=True)
    assert_same(scene_folder.open(tmp_path / "scene"), plain_scene())


def test_no_scene(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"is an empty folder, not a scene: it has no scene"):
        scene_folder.open(tmp_path)
    (tmp_path / "notes.txt").touch()
    with pytest.raises(StyleSplatError, match=r"is a folder, not a scene: it has no scene.json"):
        scene_folder.open(tmp_path)
    with pytest.raises(StyleSplatError, match="not a scene"):
        revise(plain_scene(), plain_scene(), tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("scene.json", b"{", "not valid JSON"),
        ("scene.json", b"{}", "not of version 1"),
        ("scene.json", b'{"version": 2}', "not of version 1"),
        (
            "scene.json",
            b'{"version": 1, "settings": 3}',
            r"Expected `object`, got `int` - at `\$.settings`",
        ),
        (
            "scene.json",
            b'{"version": 1, "settings": {"downscale": "x"}}',
            r"Expected `float`, got `str` - at `\$.settings.downscale`",
        ),
        ("splats.ply", b"", "not a PLY file"),
        ("splats.ply", None, "No such file"),
        ("cameras.json", None, "No such file"),
        ("cameras.json", b"{}", "required field `dtype`"),
        (
            "cameras.json",
            b'{"dtype": "float32", "cameras": [{"name": "a"}]}',
            "required field `size`",
        ),
        ("cameras.json", b'{"dtype": "float32", "cameras": 1}', "Expected `array`, got `int`"),
        ("objects.json", b"[]", "expected a JSON object"),
        ("picks.safetensors", b"1234", "Make the scene again"),
        ("picks.safetensors", None, "No such file"),
        ("identities.safetensors", b"1234", "Make the scene again"),
        ("base_colors.safetensors", b"1234", "Make the scene again"),
        ("style_colors.safetensors", None, "No such file"),
        ("paintings.safetensors", b"1234", "Make the scene again"),
        ("metrics.json", b"", "not valid JSON"),
        ("recipe.json", b"", "not valid JSON"),
        ("recipe.json", None, "No such file"),
        ("recipe.json", b"{}", "required field `objects`"),
        ("recipe.json", b'{"objects": [], "settings": {}}', "Expected `array` of length >= 1"),
        ("recipe.json", b'{"objects": [1, 2], "settings": {}}', "Expected `object`, got `int`"),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, content: bytes | None, match: str):
    scene_folder.save(full_scene(), tmp_path / "scene")
    path = tmp_path / "scene" / name
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(StyleSplatError, match=match) as caught:
        scene_folder.open(tmp_path / "scene")
    assert name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["picks", "base_colors", "style_colors", "paintings"])
def test_files_of_different_scenes(name: str, tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    path = tmp_path / "scene" / f"{name}.safetensors"
    tensors = {key: torch.cat([t, t[:1]]) for key, t in load(path.read_bytes()).items()}
    path.write_bytes(save(tensors))
    with pytest.raises(StyleSplatError, match=r"has the shape \[7.*\], .* 6 Gaussians"):
        scene_folder.open(tmp_path / "scene")


def test_identities_that_were_not_lifted_have_no_confidence(tmp_path: Path):
    scene = full_scene()
    scene = replace(scene, splats=replace(scene.splats, confidence=None))
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_confidence_of_another_scene(tmp_path: Path):
    scene = full_scene()
    splats = replace(scene.splats, confidence=None)
    scene_folder.save(replace(scene, splats=splats), tmp_path / "scene")
    path = tmp_path / "scene/identities.safetensors"
    path.write_bytes(save({**load(path.read_bytes()), "confidence": torch.ones(COUNT - 1)}))
    with pytest.raises(StyleSplatError, match=r"confidence has the shape \[5\]"):
        scene_folder.open(tmp_path / "scene")


def test_identities_without_a_classifier(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    picks = tmp_path / "scene/picks.safetensors"
    (tmp_path / "scene/identities.safetensors").write_bytes(picks.read_bytes())
    with pytest.raises(StyleSplatError, match="it has no identities"):
        scene_folder.open(tmp_path / "scene")


def test_the_camera_file_is_plain_json(tmp_path: Path):
    scene_folder.save(plain_scene(), tmp_path / "scene")
    content = json.loads((tmp_path / "scene/cameras.json").read_text())
    assert content["cameras"][1]["name"] == "sub/b.png"
    assert content["cameras"][1]["size"] == [500, 400]
