"""Names of photos come from files of strangers, and files are written under them."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch

from capture_files import HEIGHT, WIDTH, save_noise, write_capture
from processes import complaint, needs_pipes, run
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import OBJECT_MASK, load
from stylesplat.io.captures.transforms import read_transforms
from stylesplat.io.files import require_regular
from stylesplat.io.label_maps import write_label_map

POSE = np.eye(4).tolist()
LENS = {"w": WIDTH, "h": HEIGHT, "fl_x": 60.0}
BAD_NAMES = [
    "../../victim/holiday.png",
    "/tmp/a.png",
    "..\\..\\victim\\holiday.png",
    ".",
    "a\nb.png",
    "n" * 300 + ".png",
]


def rename(folder: Path, name: str) -> None:
    """Call the first image of a reconstruction something else."""
    sparse = folder / "sparse/0"
    model = pycolmap.Reconstruction(sparse)
    model.images[min(model.images)].name = name
    for path in sparse.iterdir():
        path.unlink()
    model.write(sparse)


def masks_for(folder: Path, stem: str) -> Path:
    write_label_map(torch.eye(HEIGHT, WIDTH, dtype=torch.int64), folder / f"{stem}.png")
    return folder


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    save_noise(tmp_path / "victim" / "holiday.png")
    return tmp_path / "victim" / "holiday.png"


def test_masks_overwrite_nothing_elsewhere(
    make_capture: Callable[..., Path], victim: Path, tmp_path: Path, capsys
):
    folder, before = make_capture(), victim.read_bytes()
    rename(folder, "../../victim/holiday.png")
    masks = masks_for(tmp_path / "masks", "holiday")
    line = complaint(capsys, "mask", folder, "--from", masks)
    assert "No mask" in line and "001.png" in line
    assert victim.read_bytes() == before


def write_transforms(folder: Path, *files: str) -> Path:
    folder.mkdir(exist_ok=True)
    frames = [{"file_path": file, "transform_matrix": POSE} for file in files]
    (folder / "transforms.json").write_text(json.dumps({**LENS, "frames": frames}))
    return folder


def test_photos_beside_a_capture_are_read_and_never_written(victim: Path, tmp_path: Path, capsys):
    folder, before = tmp_path / "capture", victim.read_bytes()
    save_noise(folder / "images" / "a.png")
    write_transforms(folder, "images/a.png", "../victim/holiday.png")
    assert load(folder).cameras.names == ("capture/images/a.png", "victim/holiday.png")
    assert run("mask", folder, "--from", masks_for(tmp_path / "masks", "holiday")) == 0
    assert victim.read_bytes() == before
    assert (folder / OBJECT_MASK / "victim" / "holiday.png").is_file()


@pytest.mark.parametrize("name", BAD_NAMES, ids=range(len(BAD_NAMES)))
def test_names_in_a_reconstruction_that_no_photo_may_have(
    make_capture: Callable[..., Path], said: list[str], name: str
):
    folder = make_capture()
    rename(folder, name)
    assert load(folder).cameras.names == ("001.png", "002.png")
    line = next(line for line in said if "Missing, so left out" in line)
    assert "\n" not in line and len(line) < 300


def test_two_frames_of_one_photo(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"'a\.png' is posed 2 times"):
        read_transforms(write_transforms(tmp_path, "images/a.png", "./images/b/../a.png"))


def test_a_link_in_the_folder_of_masks_is_not_followed(tmp_path: Path, capsys):
    folder = write_capture(tmp_path / "capture", count=1)
    (folder / "images/cam0").mkdir()
    (folder / "images/001.png").rename(folder / "images/cam0/001.png")
    rename(folder, "cam0/001.png")
    elsewhere = tmp_path / "elsewhere"
    save_noise(elsewhere / "001.png")
    before = (elsewhere / "001.png").read_bytes()
    (folder / OBJECT_MASK).mkdir()
    (folder / OBJECT_MASK / "cam0").symlink_to(elsewhere)
    masks = masks_for(tmp_path / "masks", "001")
    line = complaint(capsys, "mask", folder, "--from", masks, "--overwrite")
    assert "leads out of the folder" in line
    assert (elsewhere / "001.png").read_bytes() == before


@needs_pipes
@pytest.mark.parametrize(
    "file", ["transforms.json", "images/a.png", "points.ply", f"{OBJECT_MASK}/names.json"]
)
def test_pipes_are_not_waited_for(tmp_path: Path, file: str):
    save_noise(tmp_path / "images" / "a.png")
    masks_for(tmp_path / OBJECT_MASK, "a")
    write_transforms(tmp_path, "images/a.png")
    if file == "points.ply":
        path = tmp_path / "transforms.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), "ply_file_path": file}))
    (tmp_path / file).unlink(missing_ok=True)
    os.mkfifo(tmp_path / file)
    with pytest.raises(StyleSplatError, match=r"no plain file|not a capture"):
        load(tmp_path)
    with pytest.raises(StyleSplatError, match="no plain file"):
        require_regular("/dev/zero")
