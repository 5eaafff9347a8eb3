"""Scenes on disk, changed: whole or not at all, and nothing else."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from scenes import assert_same, contents, full_scene, plain_scene
from stylesplat.io import scene_folder
from stylesplat.io.scene_folder import revise
from stylesplat.scene.scene import Scene


def inodes(folder: Path) -> dict[str, int]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.stat().st_ino for path in files}


EVERYTHING: list[Callable[[Scene], Scene]] = [
    lambda scene: replace(scene.without_layers(), base=plain_scene().base),
    lambda scene: replace(scene, cameras=scene.cameras[[1]]),
    lambda scene: replace(scene, capture=None),
    lambda scene: replace(scene, objects={}),
    Scene.without_layers,
    lambda scene: scene.without_layers(["fox"]),
    lambda scene: scene.with_layers(scene.layers[::-1]),
    lambda scene: scene.with_layers((*scene.layers[1:], scene.layers[0])),
    lambda scene: scene.with_strengths({"fox": 0.2}, {"7": 1.0}),
    lambda scene: replace(
        scene, layers=(replace(scene.layers[0], object="vixen"), *scene.layers[1:])
    ),
    lambda scene: replace(scene, info={"settings": {"steps": 1}}),
    lambda scene: replace(scene, metrics={}),
]


@pytest.mark.parametrize("change", EVERYTHING)
def test_a_revised_folder_is_the_same_as_a_new_one(
    change: Callable[[Scene], Scene], tmp_path: Path
):
    scene_folder.save(full_scene(), tmp_path / "scene")
    before = scene_folder.open(tmp_path / "scene")
    revise(before, change(before), tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), change(before))
    scene_folder.save(change(before), tmp_path / "new")
    assert contents(tmp_path / "scene") == contents(tmp_path / "new")


def test_layers_that_stay_are_not_written_again(tmp_path: Path):
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    scene, before = scene_folder.open(folder), inodes(folder)
    revise(scene, scene.without_layers(["fox"]), folder)
    after = inodes(folder)
    assert after["layers/01-7.safetensors"] == before["layers/02-7.safetensors"]
    assert {name for name in after if name.startswith("layers/")} == {
        *("layers/01-7.safetensors", "layers/02-Br_cke.safetensors")
    }
    scene = scene_folder.open(folder)
    revise(scene, scene.with_strengths({"7": 0.3}), folder)
    assert inodes(folder)["layers/01-7.safetensors"] == before["layers/02-7.safetensors"]
    assert inodes(folder)["base.ply"] == before["base.ply"]


def test_a_folder_of_layers_that_leads_elsewhere_is_not_written_into(tmp_path: Path):
    folder, elsewhere = tmp_path / "scene", tmp_path / "elsewhere"
    scene_folder.save(full_scene(), folder)
    (folder / "layers").rename(elsewhere)
    (folder / "layers").symlink_to(elsewhere)
    scene, before = scene_folder.open(folder), contents(elsewhere)
    revise(scene, scene.without_layers(["fox"]), folder)
    assert contents(elsewhere) == before
    assert scene_folder.open(folder).painted_objects == ("7", "Brücke")


def test_a_reader_never_mixes_two_states(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    read, times = scene_folder.read_cameras, 0

    def meanwhile(path: Path):
        nonlocal times
        times += 1
        if times == 1:  # another process, after splats and before objects are read
            scene_folder.save(plain_scene(), folder, overwrite=True)
        return read(path)

    monkeypatch.setattr(scene_folder, "read_cameras", meanwhile)
    assert_same(scene_folder.open(folder), plain_scene())
    assert times == 2
