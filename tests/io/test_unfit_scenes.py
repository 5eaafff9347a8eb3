"""What could not be opened again is not saved."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from full_scenes import contents, full_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.scene.scene import Scene


def camera_with(**changes: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, cameras=replace(scene.cameras, **changes))


def splats_with(name: str, value: float) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        tensor = getattr(scene.splats, name).clone()
        tensor[0] = value
        return replace(scene, splats=replace(scene.splats, **{name: tensor}))

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


def test_rounded_poses_are_poses(tmp_path: Path):
    scene = full_scene()
    viewmats = scene.cameras.viewmats.clone()
    viewmats[0, 3] += torch.tensor([1e-8, -1e-7, 0.0, 1e-7])
    scene_folder.save(
        replace(scene, cameras=replace(scene.cameras, viewmats=viewmats)), tmp_path / "scene"
    )
    assert torch.equal(scene_folder.open(tmp_path / "scene").cameras.viewmats, viewmats)
