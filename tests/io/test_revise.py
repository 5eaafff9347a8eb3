"""Scenes on disk, changed: whole or not at all, and nothing else."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from full_scenes import assert_same, contents, full_scene, plain_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import folders, scene_folder
from stylesplat.io.scene_folder import revise
from stylesplat.scene.compose import with_layers, with_strengths, without_layers
from stylesplat.scene.scene import Scene, SceneObject

# All by which `folders` changes what lies in a folder, deletions aside, which are the last it does
CHANGES = [(os, "replace"), (os, "rename"), (os, "link"), (os, "mkdir"), (folders, "_exchanged")]


def inodes(folder: Path) -> dict[str, int]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.stat().st_ino for path in files}


@contextmanager
def failing(number: int, error: BaseException, *, for_good: bool = False) -> Iterator[list[str]]:
    """Let a call that changes the file system fail, and all after it; none if it is below 0."""
    calls: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        for module, name in CHANGES:
            real = getattr(module, name)

            def call(*args: Any, real: Any = real, name: str = name, **options: Any) -> Any:
                calls.append(f"{len(calls)}: {name}")
                due = len(calls) - 1
                if due == number or (for_good and 0 <= number < due):
                    raise error
                return real(*args, **options)

            patch.setattr(module, name, call)
        yield calls


def can_exchange(folder: Path) -> bool:
    one, other = folder / "one", folder / "other"
    one.mkdir()
    other.mkdir()
    exchanged = folders._exchanged(one, other)
    one.rmdir()
    other.rmdir()
    return exchanged


def test_a_revision_changes_nothing_else(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    scene, before = scene_folder.open(tmp_path / "scene"), contents(tmp_path / "scene")
    objects = {"table": SceneObject(torch.ones(len(scene.splats), dtype=torch.bool), {"count": 9})}
    after = replace(scene, objects=objects)
    revise(scene, after, tmp_path / "scene")
    found = contents(tmp_path / "scene")
    changed = {name for name in before | found if before.get(name) != found.get(name)}
    assert changed == {"picks.safetensors", "objects.json"}
    later = replace(after, metrics={"psnr": 1.0})
    revise(after, later, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), later)


EVERYTHING: list[Callable[[Scene], Scene]] = [
    lambda scene: replace(without_layers(scene), splats=plain_scene().splats),
    lambda scene: replace(scene, cameras=scene.cameras[[1]]),
    lambda scene: replace(scene, held_out=("sub/b.png",)),
    lambda scene: replace(scene, downscale=4.0),
    lambda scene: replace(scene, capture=None),
    lambda scene: replace(scene, objects={}),
    without_layers,
    lambda scene: without_layers(scene, ["fox"]),
    lambda scene: with_layers(scene, scene.layers[::-1]),
    lambda scene: with_layers(scene, (*scene.layers[1:], scene.layers[0])),
    lambda scene: with_layers(scene, scene.layers[:1]),
    lambda scene: with_strengths(scene, {"fox": 0.2}, {"7": 1.0}),
    lambda scene: replace(
        scene, layers=(replace(scene.layers[0], object="vixen"), *scene.layers[1:])
    ),
    lambda scene: replace(scene, info={"settings": {"steps": 1}}),
    lambda scene: replace(scene, metrics={}),
]


@pytest.mark.parametrize("change", EVERYTHING)
def test_whatever_changed_is_revised(change: Callable[[Scene], Scene], tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    before = scene_folder.open(tmp_path / "scene")
    revise(before, change(before), tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), change(before))


@pytest.mark.parametrize("change", EVERYTHING)
def test_a_revised_folder_is_the_same_as_a_new_one(
    change: Callable[[Scene], Scene], tmp_path: Path
):
    scene_folder.save(full_scene(), tmp_path / "scene")
    before = scene_folder.open(tmp_path / "scene")
    revise(before, change(before), tmp_path / "scene")
    scene_folder.save(change(before), tmp_path / "new")
    assert contents(tmp_path / "scene") == contents(tmp_path / "new")


def test_layers_that_stay_are_not_written_again(tmp_path: Path):
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    scene, before = scene_folder.open(folder), inodes(folder)
    revise(scene, without_layers(scene, ["fox"]), folder)
    after = inodes(folder)
    assert after["layers/01-7.safetensors"] == before["layers/02-7.safetensors"]
    assert {name for name in after if name.startswith("layers/")} == {
        *("layers/01-7.safetensors", "layers/02-Br_cke.safetensors")
    }
    scene = scene_folder.open(folder)
    revise(scene, with_strengths(scene, {"7": 0.3}), folder)
    assert inodes(folder)["layers/01-7.safetensors"] == before["layers/02-7.safetensors"]
    assert inodes(folder)["base.ply"] == before["base.ply"]


def test_a_folder_of_layers_that_leads_elsewhere_is_not_written_into(tmp_path: Path):
    folder, elsewhere = tmp_path / "scene", tmp_path / "elsewhere"
    scene_folder.save(full_scene(), folder)
    (folder / "layers").rename(elsewhere)
    (folder / "layers").symlink_to(elsewhere)
    scene, before = scene_folder.open(folder), contents(elsewhere)
    revise(scene, without_layers(scene, ["fox"]), folder)
    assert contents(elsewhere) == before
    assert scene_folder.open(folder).painted_objects == ("7", "Brücke")


def test_a_revision_copies_nothing_and_keeps_what_is_not_ours(tmp_path: Path):
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    (folder / "selections").mkdir()
    (folder / "selections" / "fox.png").write_bytes(b"a fox")
    (folder / "notes.txt").write_text("mine")
    scene, before = scene_folder.open(folder), inodes(folder)
    revise(scene, replace(scene, metrics={"psnr": 1.0}), folder)
    after = inodes(folder)
    assert {name for name in before | after if before.get(name) != after.get(name)} == {
        "metrics.json"
    }
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


class Killed(BaseException):
    """The end of the process, as far as a test can have it."""


@pytest.mark.parametrize("way", ["exchange", "two renames", "file by file", "no room beside"])
@pytest.mark.parametrize("error", [OSError(errno.EIO, "Input/output error"), Killed()])
def test_a_revision_is_whole_or_not_at_all(
    error: BaseException, way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Whichever call to the file system fails, and be it the last call of all."""
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    if way == "two renames":  # where the system cannot exchange
        monkeypatch.setattr(folders, "_exchanged", lambda one, other: False)
    if way == "file by file":  # where somebody stands in the folder
        monkeypatch.chdir(folder)
    if way == "no room beside":  # where the folder is a volume, or its parent is read-only
        monkeypatch.setattr(folders, "_has_room_beside", lambda path: False)
    (folder / "notes.txt").write_text("mine")
    scene = scene_folder.open(folder)
    changed = replace(without_layers(scene), splats=plain_scene().splats, metrics={})
    whole = [contents(folder)]
    with failing(-1, error) as calls:
        revise(scene, changed, folder)
    assert len(calls) > 10
    whole.append(contents(folder))
    assert whole[0] != whole[1]
    for number in range(len(calls)):
        revise(changed, scene, folder)
        assert contents(folder) == whole[0]
        with failing(number, error), suppress(StyleSplatError, Killed):
            revise(scene, changed, folder)
        assert contents(folder) in whole, calls[number]
        assert [path.name for path in tmp_path.iterdir()] == ["scene"], calls[number]


def test_a_revision_survives_its_process(tmp_path: Path):
    """Nothing is done after the call that fails, not even what would mend it."""
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    if not can_exchange(tmp_path):
        pytest.skip("this file system cannot swap two folders at once")
    scene = scene_folder.open(folder)
    changed = replace(without_layers(scene), splats=plain_scene().splats)
    whole = [contents(folder)]
    with failing(-1, Killed()) as calls:
        revise(scene, changed, folder)
    whole.append(contents(folder))
    for number in range(len(calls)):
        revise(changed, scene, folder)
        with failing(number, Killed(), for_good=True), suppress(Killed):
            revise(scene, changed, folder)
        assert contents(folder) in whole, calls[number]


def test_a_folder_that_one_stands_in_stays_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A shell would else be left in a folder that is gone."""
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    scene = scene_folder.open(folder)
    monkeypatch.chdir(folder)
    revise(scene, without_layers(scene), Path())
    assert_same(scene_folder.open("."), without_layers(scene))
    assert not Path("recipe.json").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]
