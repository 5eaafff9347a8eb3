"""Photos in, a capture with poses out."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from PIL import Image

import stylesplat as ss
from capture_files import corner, photograph_corner, places_around, towards, write_photos
from colmap_here import colmap_in_this_process  # noqa: F401  (a fixture)
from stylesplat.io.captures.capture_folder import read_sfm
from stylesplat.io.captures.lens import Lens
from stylesplat.progress import Observer, Task, observed

COUNT = 8


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photos of a textured corner, one of them twice and one of them no picture."""
    folder = tmp_path_factory.mktemp("sfm") / "Ma pièce"
    pictures = corner(COUNT)
    write_photos(folder, pictures | {"again.jpg": pictures["02.jpg"]})
    (folder / "broken.jpg").write_bytes(b"\xff\xd8\xff no photo")
    return folder


@pytest.fixture(scope="module")
def capture(photos: Path) -> ss.Capture:
    return ss.sfm(photos, photos.with_name("capture"), max_features=500)


def test_all_that_fit_are_posed(capture: ss.Capture, photos: Path):
    assert capture.cameras.names == tuple(f"{i:02}.jpg" for i in range(COUNT))
    assert capture.path == photos.with_name("capture")
    assert capture.points is not None and len(capture.points) > 200
    steps = capture.cameras.positions.diff(dim=0).norm(dim=1)
    truth = torch.from_numpy(places_around(COUNT, spread=COUNT / 10)).diff(dim=0).norm(dim=1)
    ratio = steps / truth.float()
    assert (ratio / ratio.median() - 1).abs().max() < 0.02


def test_what_became_of_each_photo_is_written_down(capture: ss.Capture, photos: Path):
    assert capture.path is not None
    record = read_sfm(capture.path)
    assert record is not None
    assert (record.given, record.registered) == (COUNT + 2, COUNT)
    assert record.source == str(photos)
    (again,) = record.left_out.keys() - {"broken.jpg"}
    assert again in ("02.jpg", "again.jpg") and "nearly the same" in record.left_out[again]
    assert record.frame["up"] == [0, -1, 0]
    (taken,) = record.lenses
    assert sorted(taken.photos) == [*capture.cameras.names]
    lens = Lens.create(taken.model, taken.width, taken.height, taken.params)
    assert lens.pinhole().size == capture.cameras.size
    assert json.loads((capture.path / "sfm.json").read_text())["format"] == 1
    assert {p.name for p in capture.path.iterdir()} == {"images", "sparse", "sfm.json", "check.jpg"}
    assert {p.name for p in photos.parent.iterdir()} == {"Ma pièce", "capture"}


class InterruptedAt(Observer):
    """Ctrl-C when a kind of work begins."""

    def __init__(self, stage: str) -> None:
        self.stage = stage

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[Task]:
        if what == self.stage:
            raise KeyboardInterrupt
        yield self


@pytest.mark.usefixtures("colmap_in_this_process")
def test_each_photo_without_a_pose_is_named_once(tmp_path: Path, said: list[str]):
    elsewhere = photograph_corner(towards(places_around(COUNT))[3], seed=9)
    write_photos(tmp_path / "photos", corner(COUNT) | {"elsewhere.jpg": elsewhere})
    ss.sfm(tmp_path / "photos", tmp_path / "capture", max_features=500)
    (line,) = [line for line in said if "elsewhere.jpg" in line]
    assert line.startswith("Not posed: ")
    assert any(line.startswith("Take more photos between") for line in said)


@pytest.mark.usefixtures("colmap_in_this_process")
def test_an_interrupted_call_goes_on_and_keeps_label_maps(
    capture: ss.Capture, photos: Path, tmp_path: Path
):
    output, partial = tmp_path / "capture", tmp_path / "capture.partial"
    assert capture.path is not None
    shutil.copytree(capture.path, output)
    (output / "object_mask").mkdir()
    Image.new("L", capture.cameras[0].size, 3).save(output / "object_mask" / "00.png")
    partial.mkdir()
    (partial / "diary.txt").write_text("dear")
    before = {file: file.read_bytes() for file in output.rglob("*") if file.is_file()}
    for stage in ("finding features", "finding poses", "undistorting photos"):
        with observed(InterruptedAt(stage)), pytest.raises(KeyboardInterrupt):
            ss.sfm(photos, output, overwrite=True, max_features=500)
        assert {file: file.read_bytes() for file in output.rglob("*") if file.is_file()} == before
        assert (partial / "sfm" / "prepared" / "00.jpg").is_file()
    assert len(ss.sfm(photos, output, overwrite=True, max_features=500)) == COUNT
    by_hand = output / "object_mask" / "00.png"
    assert by_hand.read_bytes() == before[by_hand]
    assert [p.name for p in partial.iterdir()] == ["diary.txt"]


def test_places_that_cannot_be(photos: Path, tmp_path: Path):
    (tmp_path / "diary.txt").write_text("dear")
    with pytest.raises(ss.StyleSplatError, match=r"holds something else\. Choose another"):
        ss.sfm(photos, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["diary.txt"]
    with pytest.raises(ss.StyleSplatError, match="lies inside of"):
        ss.sfm(photos, photos / "capture")
    with pytest.raises(ss.StyleSplatError, match="which would be replaced"):
        ss.sfm(photos, photos.parent, overwrite=True)
    assert (photos / "00.jpg").is_file()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frames": 2}, "Cannot choose 2 frames"),
        ({"matchin": "auto"}, "Did you mean 'matching'"),
        ({"matching": "all"}, "with matching .*exhaustive"),
    ],
)
def test_settings(settings: dict, message: str, photos: Path, tmp_path: Path):
    with pytest.raises(ss.StyleSplatError, match=message):
        ss.sfm(photos, tmp_path / "capture", **settings)
    assert not any(tmp_path.iterdir())
