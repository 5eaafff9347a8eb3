"""Scenes on disk, changed: whole or not at all, and nothing else."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from scenes import assert_same, contents, full_scene, plain_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import atomic, scene_folder
from stylesplat.io.scene_folder import revise
from stylesplat.scene.compose import with_layers, with_strengths, without_layers
from stylesplat.scene.scene import Scene

# All calls that change what lies in a folder, deletions aside, which come last
CHANGES = [(os, "replace"), (os, "rename"), (os, "link"), (os, "mkdir"), (atomic, "_exchange")]


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


class Killed(BaseException):
    """The end of the process, as far as a test can have it."""


@pytest.mark.parametrize(
    ("error", "exchange", "for_good"),
    [
        (OSError(errno.EIO, "Input/output error"), True, False),
        (Killed(), True, True),  # nothing is done after the call, not even what would mend it
        (Killed(), False, False),  # where the system cannot swap two names
    ],
    ids=["error", "killed", "two renames"],
)
def test_a_revision_is_whole_or_not_at_all(
    error: BaseException,
    exchange: bool,
    for_good: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    """Whichever call to the file system fails."""
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    if not exchange:
        monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
    (folder / "notes.txt").write_text("mine")
    scene = scene_folder.open(folder)
    changed = replace(without_layers(scene), splats=plain_scene().splats, metrics={})
    whole = [contents(folder)]
    with failing(-1, error) as calls:
        revise(scene, changed, folder)
    if exchange and not any("_exchange" in call for call in calls):
        pytest.skip("this file system cannot swap two folders at once")
    whole.append(contents(folder))
    assert len(calls) > 10 and whole[0] != whole[1]
    for number in range(len(calls)):
        revise(changed, scene, folder)
        with (
            failing(number, error, for_good=for_good),
            suppress(StyleSplatError, Killed),
        ):
            revise(scene, changed, folder)
        assert contents(folder) in whole, calls[number]
        assert for_good or [path.name for path in tmp_path.iterdir()] == ["scene"], calls[number]


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
