import shutil
from collections.abc import Callable
from pathlib import Path

import pycolmap
import pytest

from capture_files import HEIGHT, PINHOLE, WIDTH, lenses_of, reconstruction
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap import read_colmap, read_figures
from stylesplat.io.captures.colmap_files import check_complete
from stylesplat.io.captures.posed_files import PosedFiles
from stylesplat.io.kinds import find_poses

READ = ["cameras", "images", "points3D"]
BINARIES = [*READ, "rigs", "frames"]


def read(folder: Path) -> PosedFiles:
    return read_colmap(folder, find_poses(folder)[0].paths)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("sparse", ["sparse/0", "sparse"])
def test_poses_points_and_names(make_capture: Callable[..., Path], text: bool, sparse: str):
    posed = read(make_capture(text=text, sparse=sparse))
    assert posed.names == ("001.png", "002.png", "003.png")
    assert posed.viewmats[:, 0, 3].tolist() == [-2, -1, 0]
    assert lenses_of(posed)[0].size == (WIDTH, HEIGHT)
    assert lenses_of(posed)[0].params == tuple(PINHOLE[1])
    assert posed.points is not None and posed.point_colors is not None
    assert posed.points.tolist() == [[i, 0.5, 5.0] for i in range(4)]
    assert posed.point_colors.tolist() == [[10 * i, 20, 30] for i in range(4)]


def test_smaller_copies_stand_in_for_images(make_capture: Callable[..., Path]):
    folder = make_capture(images="images_4")
    shutil.copytree(folder / "images_4", folder / "images_8")
    (folder / "images_2").mkdir()
    assert read(folder).paths[0] == folder / "images_4" / "001.png"
    shutil.copytree(folder / "images_4", folder / "images_2", dirs_exist_ok=True)
    assert read(folder).paths[0] == folder / "images_2" / "001.png"


def test_no_photos(make_capture: Callable[..., Path]):
    folder = make_capture(images="elsewhere")
    shutil.rmtree(folder / "elsewhere")
    with pytest.raises(StyleSplatError, match=r"none of the 3 photos .*003\.png.* images"):
        read(folder)


def test_no_posed_images(make_capture: Callable[..., Path]):
    with pytest.raises(StyleSplatError, match="1 cameras and 0 images, none of them posed"):
        read(make_capture(count=0))


@pytest.mark.parametrize("name", BINARIES)
def test_every_truncation_is_noticed(make_capture: Callable[..., Path], name: str):
    folder = make_capture()
    path = folder / "sparse/0" / f"{name}.bin"
    whole = path.read_bytes()
    for content in [*(whole[:end] for end in range(len(whole))), whole + b"\0"]:
        path.write_bytes(content)
        with pytest.raises(StyleSplatError, match=rf"{name}\.bin is truncated or damaged"):
            read(folder) if name in READ else check_complete(path.parent)


@pytest.mark.parametrize("name", BINARIES)
def test_an_absurd_count_takes_no_memory(make_capture: Callable[..., Path], name: str):
    path = make_capture() / "sparse/0" / f"{name}.bin"
    path.write_bytes(b"\xff" * 7 + path.read_bytes()[7:])
    with pytest.raises(StyleSplatError, match=rf"{name}\.bin is truncated or damaged"):
        check_complete(path.parent)


def test_rigs_of_several_cameras_are_complete(tmp_path: Path):
    model = reconstruction(*PINHOLE, count=0)
    rig = pycolmap.Rig(rig_id=7)
    for number in (2, 3, 4):
        model.add_camera(
            pycolmap.Camera(model="PINHOLE", width=8, height=8, params=[9.0] * 4, camera_id=number)
        )
        sensor = pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=number)
        if number == 2:
            rig.add_ref_sensor(sensor)
        else:
            rig.add_sensor(sensor, pycolmap.Rigid3d() if number == 3 else None)
    model.add_rig(rig)
    model.add_rig(pycolmap.Rig(rig_id=9))
    model.write(tmp_path)
    check_complete(tmp_path)
    assert pycolmap.Reconstruction(tmp_path).num_rigs() == 3


def test_there_are_no_figures_without_a_model_or_tracks(
    make_capture: Callable[..., Path], tmp_path: Path
):
    assert read_figures(tmp_path / "nowhere") is None
    assert read_figures(make_capture()) is None
