"""Scenes in a world whose coordinates are too large for float32, from end to end."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, PLAIN
from capture_files import write_ball_capture
from scenes import full_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.cameras import read_camera_path
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.scene_folder import revise
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import NERFSTUDIO_AXES, Frame, known_frames, move_cameras, move_splats
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.scene.world_offset import Offset, to_world
from stylesplat.studio_app.history import StudioState
from stylesplat.studio_app.selecting import name_selection, pick_ball, pick_box
from stylesplat.training.config import TrainConfig
from stylesplat.verbs.export import export
from stylesplat.verbs.import_ import FrameName, import_
from stylesplat.verbs.objects import extents
from stylesplat.verbs.select import select
from stylesplat.verbs.train import train

WORLD = (4e6, -3e6, 5e6)
NEAR = replace(PLAIN, shN=PLAIN.shN[:, :0])
FAR = replace(NEAR, world_offset=WORLD)
SCENE = Scene(FAR, CAMERAS)
RED_BOX = (-1.1, -0.4, 0.02, -0.3, 0.4, 0.7)


def moved(capture: Capture, offset: Offset = WORLD) -> Capture:
    """A capture of that world, whose own offset is another one, as `load` may choose it."""
    shift = Frame(torch.eye(3), 1.0, torch.tensor([-1.0, 2.0, 0.0]))
    x, y, z = offset
    cameras = move_cameras(capture.full_cameras, shift)
    assert capture.points is not None and shift.shift is not None
    points = capture.points + shift.shift
    there = (x + 1, y - 2, z)
    return replace(capture, cameras=cameras, full=None, points=points, world_offset=there)


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return load(write_ball_capture(tmp_path_factory.mktemp("capture")))


@pytest.fixture(scope="module")
def far(near: Capture) -> Capture:
    return moved(near)


def places(scene: Scene) -> torch.Tensor:
    return to_world(scene.splats.means, scene.world_offset)


def test_a_scene_keeps_it(tmp_path: Path):
    plain = full_scene()
    scene = replace(plain, base=replace(plain.base, world_offset=WORLD))
    scene_folder.save(scene, tmp_path / "far")
    scene_folder.save(plain, tmp_path / "near")
    assert json.loads((tmp_path / "far/scene.json").read_text())["world_offset"] == [*WORLD]
    assert "world_offset" not in (tmp_path / "near/scene.json").read_text()
    for name in ("splats.ply", "base.ply", "cameras.json"):
        here, there = (tmp_path / each / name for each in ("near", "far"))
        assert here.read_bytes() == there.read_bytes()
    found = scene_folder.open(tmp_path / "far")
    assert found.world_offset == found.base.world_offset == WORLD
    weaker = found.with_strengths({"fox": 0.3})
    assert weaker.world_offset == WORLD
    revise(found, weaker, tmp_path / "far")
    assert scene_folder.open(tmp_path / "far").world_offset == WORLD


def test_training_there_is_training_here(near: Capture, far: Capture):
    config = TrainConfig(steps=120, max_gaussians=800, photos_at_once=2, test_every=4)
    here, there = (train(each, config, device="cpu") for each in (near, far))
    assert there.world_offset == far.world_offset
    assert there.metrics["psnr"] == pytest.approx(here.metrics["psnr"], abs=0.5)
    middle = places(there).median(dim=0).values
    expected = places(here).median(dim=0).values + torch.tensor(WORLD).double()
    torch.testing.assert_close(middle, expected, atol=0.1, rtol=0)


def assert_shows_the_photos(scene: Scene, far: Capture) -> None:
    assert scene.metrics["psnr"] > 30
    assert scene.world_offset == far.world_offset
    torch.testing.assert_close(
        places(scene), to_world(NEAR.means, WORLD), atol=1e-6, rtol=0, check_dtype=False
    )


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_a_splat_and_photos_of_that_world(
    suffix: str, far: Capture, tmp_path: Path, said: list[str]
):
    export(FAR, tmp_path / f"a{suffix}")
    assert_shows_the_photos(import_(tmp_path / f"a{suffix}", far, device="cpu"), far)
    assert not any("relative to" in line for line in said)


def test_a_splat_that_lost_it_on_the_way(far: Capture, tmp_path: Path, said: list[str]):
    """A format without it has coordinates relative to the offset of the capture."""
    splats = FAR.relative_to(far.world_offset)
    export(splats, tmp_path / "a.splat")
    scene = import_(tmp_path / "a.splat", far, device="cpu")
    assert scene.metrics["psnr"] > 30 and scene.world_offset == far.world_offset
    assert any("a.splat lies around the origin" in line for line in said)


def test_a_splat_of_another_place_is_refused(far: Capture):
    elsewhere = replace(NEAR, means=NEAR.means + 50)
    with pytest.raises(StyleSplatError, match=r"they were taken around 40000\d\d\.\d+,-30000"):
        import_(elsewhere, far, device="cpu")
    with pytest.raises(StyleSplatError, match=r"lies around 70000\d\d\.\d+"):
        import_(replace(NEAR, world_offset=(7e6, 0.0, 0.0)), far, device="cpu")


@pytest.mark.parametrize("frame", ["nerfstudio", "nerfstudio-axes"])
def test_frames_of_other_programs(frame: FrameName, far: Capture, tmp_path: Path):
    splats = move_splats(NEAR, known_frames(CAMERAS)[frame])
    if frame == "nerfstudio-axes":
        x, y, z = (NERFSTUDIO_AXES @ torch.tensor(WORLD)).tolist()
        splats = replace(splats, world_offset=(x, y, z))
    export(splats, tmp_path / "a.ply")
    with pytest.raises(StyleSplatError, match=f"Pass --frame {frame}"):
        import_(tmp_path / "a.ply", far, device="cpu")
    scene = import_(tmp_path / "a.ply", far, frame=frame, device="cpu")
    assert scene.metrics["psnr"] > 25
    expected = to_world(splats.means, splats.world_offset)
    torch.testing.assert_close(places(scene), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_a_splat_comes_back_from_elsewhere(suffix: str, tmp_path: Path):
    scene = select(SCENE, "red", box3d=in_world(RED_BOX))
    export(scene, tmp_path / f"a{suffix}")
    found = import_(tmp_path / f"a{suffix}", like=scene)
    assert found.metrics["matched"] == len(NEAR) and not found.metrics["moved"]
    assert found.world_offset == WORLD and torch.equal(found.cameras.viewmats, CAMERAS.viewmats)
    assert torch.equal(found.objects["red"].mask, scene.objects["red"].mask)


def in_world(corners: tuple[float, ...], offset: Offset = WORLD) -> tuple[float, ...]:
    return tuple(to_world(torch.tensor(corners).double().view(2, 3), offset).flatten().tolist())


def test_places_that_are_typed_are_in_the_world():
    here = select(Scene(NEAR, CAMERAS), "red", box3d=RED_BOX)
    there = select(SCENE, "red", box3d=in_world(RED_BOX))
    assert torch.equal(there.objects["red"].mask, here.objects["red"].mask)
    ball = (4e6 - 0.7, -3e6, 5e6 + 0.3, 0.35)
    picked = select(SCENE, "red", sphere=ball).objects["red"].mask
    assert picked.sum() >= 80
    with pytest.raises(StyleSplatError, match=r"reaches from 3999998\.\d+,-3000001\.\d+,"):
        select(SCENE, "none", box3d=RED_BOX)


def test_places_that_are_read_are_in_the_world():
    here = extents(select(Scene(NEAR, CAMERAS), "red", box3d=RED_BOX))["named"]["red"]
    there = extents(select(SCENE, "red", box3d=in_world(RED_BOX)))["named"]["red"]
    assert there["size"] == here["size"]
    centre = [x + shift for x, shift in zip(here["centre"], WORLD, strict=True)]
    assert there["centre"] == pytest.approx(centre, abs=1e-6)
    again = select(SCENE, "again", box3d=there["box"]).objects["again"]
    assert again.mask.sum() >= 78


def test_the_studio_records_places_in_the_world():
    state = StudioState(SCENE)
    low, high = RED_BOX[:3], RED_BOX[3:]
    box = name_selection(pick_box(state, low, high), "box")
    (box,) = box.scene.objects["box"].selection.box3d
    assert box == pytest.approx(in_world(RED_BOX), abs=1e-4)
    ball = name_selection(pick_ball(state, CAMERAS[0], (0.5, 0.5), 0.4), "ball")
    found = ball.scene.objects["ball"]
    ((_, (*centre, radius)),) = found.selection.sphere
    assert centre == pytest.approx(WORLD, abs=2) and radius == 0.4


def test_camera_paths_are_in_the_world(tmp_path: Path):
    def cameras(eye: list[float], focus: list[float], offset: Offset) -> torch.Tensor:
        frames = [{"position": eye, "look_at": focus}, {"view": "0001.jpg"}]
        (tmp_path / "path.json").write_text(json.dumps({"keyframes": frames}))
        path = read_camera_path(tmp_path / "path.json", CAMERAS, world_offset=offset)
        return path.cameras.viewmats

    here = cameras([0.0, -4.0, 2.0], [0.0, 0.5, 0.0], (0.0, 0.0, 0.0))
    there = cameras([4e6, -3e6 - 4, 5e6 + 2], [4e6, -3e6 + 0.5, 5e6], WORLD)
    torch.testing.assert_close(there, here, atol=1e-6, rtol=0)


def test_renders_are_those_of_the_origin(tmp_path: Path):
    """Of a splat without photos: its views go around its content, wherever that is."""

    def image(splats: Splats, name: str) -> torch.Tensor:
        export(splats, tmp_path / name)
        scene = import_(tmp_path / name, up="z", device="cpu")
        return rasterize(scene.splats, scene.cameras[0])[0]

    here, there = image(NEAR, "near.ply"), image(FAR, "far.ply")
    assert (here - there).abs().max() < 1e-3
