"""Where a capture keeps its poses, and which are used."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from capture_files import HEIGHT, WIDTH, save_noise, write_ball_capture, write_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.captures.colmap import read_figures
from stylesplat.io.kinds import find_foreign_poses, is_posed, kind_of
from stylesplat.structure_from_motion.photos import find_sources
from stylesplat.verbs.sfm import check

MakeCapture = Callable[..., Path]
NAMES = ("001.png", "002.png", "003.png")


@pytest.mark.parametrize(
    ("sparse", "images"),
    [
        ("colmap/sparse/0", "images"),
        ("colmap/sparse", "colmap/images"),
        ("colmap", "images_2"),
        ("dense/0/sparse", "dense/0/images"),
        ("dense/sparse", "images"),
        ("distorted/sparse/0", "input"),
        (".", "images"),
        (".", "."),
        ("images", "images"),
    ],
)
@pytest.mark.parametrize("text", [False, True])
def test_models_are_found(make_capture: MakeCapture, sparse: str, images: str, text: bool):
    folder = make_capture(sparse=sparse, images=images, text=text)
    assert is_posed(folder) and kind_of(folder) == "capture"
    capture = load(folder)
    assert capture.cameras.names == NAMES
    assert {each.what: each for each in check(capture).findings}["posed"].number == 1
    with pytest.raises(StyleSplatError, match="has its poses already"):
        find_sources(folder, skip=folder / "nothing")


def test_photos_without_a_pose_are_told_wherever_they_are(tmp_path: Path, said: list[str]):
    folder = write_capture(tmp_path / "beside", sparse=".", images=".")
    save_noise(folder / "renders/001.png")
    save_noise(folder / "object_mask/002.png")
    save_noise(folder / "009.png")
    load(folder, masks=False)
    assert ["out: 009.png (1 of the 4 photos" in line for line in said] == [True]


def two_models(folder: Path, *, few: int = 2, many: int = 5) -> Path:
    write_capture(folder, sparse="sparse/1", count=many)
    write_capture(folder / "other", count=few)
    shutil.move(folder / "other/sparse/0", folder / "sparse/0")
    shutil.rmtree(folder / "other")
    return folder


def test_the_largest_model_is_used(tmp_path: Path, said: list[str]):
    folder = two_models(tmp_path / "capture")
    assert len(load(folder)) == 5
    (line,) = said
    assert "2 models" in line and "1 is used" in line and "left out: 0 (2)" in line
    for name in ("003.png", "004.png", "005.png"):
        (folder / "images" / name).unlink()
    assert load(folder).cameras.names == ("001.png", "002.png"), "photos that are there count"


def test_other_models_may_be_empty(tmp_path: Path):
    folder = two_models(tmp_path / "capture", few=0)
    (folder / "sparse/2").mkdir()
    shutil.copy(folder / "sparse/0/cameras.bin", folder / "sparse/2")
    assert len(load(folder)) == 5


def test_poses_in_two_forms(tmp_path: Path, said: list[str]):
    folder = write_ball_capture(tmp_path, masks=False)
    save_noise(folder / "images/001.png", (WIDTH, HEIGHT))
    write_capture(folder, sparse="colmap/sparse/0", count=1)
    assert "001.png" not in load(folder).cameras.names
    assert "transforms.json are used, not colmap/sparse/0" in said[0]
    assert read_figures(folder) is None
    shutil.move(folder / "colmap/sparse", folder / "sparse")
    assert load(folder).cameras.names == ("001.png",)
    assert "sparse/0 are used, not transforms.json" in next(s for s in said[1:] if "used" in s)


def test_half_a_model_is_named(make_capture: MakeCapture):
    folder = make_capture()
    (folder / "sparse/0/images.bin").unlink()
    with pytest.raises(StyleSplatError, match=r"sparse/0 has no images\.bin"):
        load(folder)


@pytest.mark.parametrize(
    "path",
    [
        "cameras.xml",
        "images/bundle.rd.out",
        "poses/poses.txt",
        "Scene.NVM",
        "nerf/transforms.json",
        "reconstruction.json",
    ],
)
def test_poses_that_are_not_read_are_known(tmp_path: Path, path: str):
    save_noise(tmp_path / "images" / "a.png")
    assert find_foreign_poses(tmp_path) == []
    (tmp_path / path).parent.mkdir(exist_ok=True)
    (tmp_path / path).touch()
    assert find_foreign_poses(tmp_path) == [tmp_path / path]
    beside = [tmp_path / path] if Path(path).parent.name in ("", "images") else []
    assert find_foreign_poses(tmp_path / "images") == beside


def test_a_model_elsewhere_is_known(tmp_path: Path):
    save_noise(tmp_path / "a.png")
    write_capture(tmp_path / "run", sparse="model")
    assert find_foreign_poses(tmp_path) == [tmp_path / "run/model"]
