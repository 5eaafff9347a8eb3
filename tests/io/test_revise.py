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

from full_scenes import COUNT, assert_same, contents, full_scene, painted, plain_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import folders, scene_folder
from stylesplat.io.scene_folder import revise
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
    objects = {"table": SceneObject(torch.ones(COUNT, dtype=torch.bool), {"count": COUNT})}
    after = replace(scene, objects=objects)
    revise(scene, after, tmp_path / "scene")
    found = contents(tmp_path / "scene")
    changed = {name for name in before | found if before.get(name) != found.get(name)}
    assert changed == {"picks.safetensors", "objects.json"}
    later = replace(after, metrics={"psnr": 1.0})
    revise(after, later, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), later)


EVERYTHING: list[Callable[[Scene], Scene]] = [
    lambda scene: replace(scene, splats=plain_scene().splats),
    lambda scene: replace(scene, splats=replace(scene.splats, confidence=None)),
    lambda scene: replace(scene, cameras=scene.cameras[[1]]),
    lambda scene: replace(scene, held_out=("sub/b.png",)),
    lambda scene: replace(scene, downscale=4.0),
    lambda scene: replace(scene, capture=None),
    lambda scene: replace(scene, objects={}),
    lambda scene: replace(scene, painted=None),
    lambda scene: replace(scene, painted=replace(painted(), origin=None)),
    lambda scene: replace(scene, info={"settings": {"steps": 1}}),
    lambda scene: replace(scene, metrics={}),
]


@pytest.mark.parametrize("change", EVERYTHING)
def test_whatever_changed_is_revised(change: Callable[[Scene], Scene], tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    before = scene_folder.open(tmp_path / "scene")
    revise(before, change(before), tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), change(before))


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
    changed = replace(scene, splats=plain_scene().splats, painted=None, metrics={})
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
    changed = replace(scene, splats=plain_scene().splats, painted=None)
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
    revise(scene, replace(scene, painted=None), Path())
    assert_same(scene_folder.open("."), replace(scene, painted=None))
    assert not Path("recipe.json").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]
