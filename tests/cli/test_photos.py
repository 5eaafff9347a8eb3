"""Which capture belongs to photos that have no poses."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture_files import corner, save_noise, sfm_record, write_capture, write_photos
from processes import complaint, result, run
from stylesplat.cli.sfm import find_photos_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import read_sfm, write_sfm
from stylesplat.io.scene_folder import open as open_scene
from stylesplat.structure_from_motion.earlier_capture import (
    capture_place,
    find_earlier_capture,
    source_digest,
    view_of_photo,
)


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    for i in range(3):
        save_noise(tmp_path / "My photos" / f"{i}.png", seed=i)
    return tmp_path / "My photos"


def write_record(folder: Path, photos: Path) -> Path:
    write_sfm(
        sfm_record(
            source=str(photos.resolve()),
            digest=source_digest(photos),
            given=3,
            registered=3,
        ),
        folder,
    )
    return folder


def test_an_earlier_capture_is_found_beside_the_photos_and_the_scene(photos: Path, tmp_path: Path):
    scene = tmp_path / "elsewhere" / "scene"
    for near in (scene, photos):  # those beside the photos come first
        place = capture_place(photos, beside=near)
        assert place == near.parent / "My photos-capture"
        write_record(write_capture(place), photos)
        assert find_photos_capture(photos, beside=scene) == place
    (tmp_path / "walk.mp4").write_bytes(b"")
    assert capture_place(tmp_path / "walk.mp4", beside=tmp_path / "scene").name == "walk-capture"
    among = capture_place(photos, beside=photos / "sub" / "scene")
    assert among.parent == tmp_path, "never among the photos"
    with pytest.raises(StyleSplatError, match="Choose another name"):
        find_photos_capture(photos, beside=tmp_path / "My photos-capture")


def test_poses_that_nobody_has_found_are_found_first(
    photos: Path, tmp_path: Path, said: list[str], monkeypatch: pytest.MonkeyPatch
):
    made = []
    monkeypatch.setattr("stylesplat.verbs.sfm.sfm", lambda *places: made.append(places))
    output = find_photos_capture(photos, beside=tmp_path / "scene")
    assert made == [(photos, output)] and output.name == "My photos-capture"
    assert len(said) == 1 and "has no camera poses: finding them first" in said[-1]
    (photos / "cameras.xml").touch()
    find_photos_capture(photos, beside=tmp_path / "scene")
    assert f"{photos / 'cameras.xml'} may hold poses" in said[1] and "found anew" in said[1]


def test_a_capture_of_other_photos_is_not_taken(photos: Path, tmp_path: Path):
    others = shutil.copytree(photos, tmp_path / "others" / photos.name)
    place = write_record(write_capture(capture_place(photos, beside=photos)), photos)
    save_noise(photos / "sub" / "4.png")
    with pytest.raises(StyleSplatError, match=r"have changed since .* sfm .* --overwrite`"):
        find_earlier_capture(photos, beside=photos)
    write_record(place, others)
    assert find_earlier_capture(photos, beside=photos) is None
    with pytest.raises(StyleSplatError, match=r"something else\. Find them with .* -o CAPTURE`"):
        find_photos_capture(photos, beside=photos)


def test_photos_by_the_names_that_the_user_knows(photos: Path, tmp_path: Path):
    record = read_sfm(write_record(write_capture(tmp_path / "capture"), photos))
    assert record is not None
    record.origins, record.left_out = {"a/1_png.png": "a/1.png"}, {"2.jpg": "blurred"}
    assert view_of_photo("a/1.png", record) == "a/1_png.png"
    assert view_of_photo("3.jpg", record) == view_of_photo("3.jpg", None) == "3.jpg"
    assert view_of_photo("a/1", record) == "a/1_png.png", "suffixes may be left out"
    for name in ("2.jpg", "2"):
        with pytest.raises(StyleSplatError, match=r"2\.jpg has no pose: blurred"):
            view_of_photo(name, record)


@pytest.mark.parametrize(
    ("box", "facts"),
    [
        ("dozer=lost.png:1,2,30,40", ("'lost.png'", "0.png, 1.png, 2.png")),
        ("dozer=1.png:1,2,3000,40", ("3000", "1.png", "pixels")),
    ],
)
def test_boxes_in_no_photo_are_refused_before_poses_are_found(
    box: str, facts: tuple[str, ...], photos: Path, capsys: pytest.CaptureFixture[str]
):
    line = complaint(capsys, "mask", photos, "--box", box)
    assert all(fact in line for fact in facts) and ".jpg" not in line
    assert [path.name for path in photos.parent.iterdir()] == [photos.name], "nothing was begun"


def save_ids(path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(np.array([[0], [3]], np.uint8).repeat(120, axis=0).repeat(320, axis=1)).save(
        path
    )


def test_from_photos_to_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """`sfm` finds the poses; `mask` and `train` take them from the capture beside the photos."""
    photos = tmp_path / "Walls"
    write_photos(photos, corner(5) | {"blank.jpg": np.full((240, 320), 90, np.uint8)})
    for name in corner(5):
        save_ids(tmp_path / "ids" / name.replace("jpg", "png"))
    capture = tmp_path / "Walls-capture"
    found = result(capsys, "sfm", photos, "-o", capture)
    assert (found["registered"], found["photos"]) == (5, 6)
    assert [*found["left_out"], *found["unregistered"]] == ["blank.jpg"]
    assert run("mask", photos, "--from", tmp_path / "ids") == 0
    assert {p.name for p in capture.iterdir()} >= {"images", "sparse", "object_mask"}
    out = tmp_path / "scene"
    assert run("train", photos, "-o", out, "--steps", 4, "--device", "cpu") == 0
    assert f"taking those in {capture}" in capsys.readouterr().err
    assert open_scene(out).splats.classifier is not None
    assert "--overwrite" in complaint(capsys, "sfm", photos, "-o", capture)


@pytest.mark.parametrize(
    ("options", "fact"),
    [
        (("--object", "1.png:3,4"), "Expected VIEW:x0,y0,x1,y1"),
        (("--object", "9.png:3,4,20,30"), "No view is called '9.png'"),
        (("--masks", "nowhere"), "There is no folder or .json file nowhere"),
        (("--masks", "nowhere", "--object", "1.png:3,4,20,30"), "Give one of them"),
    ],
)
def test_objects_to_pose_that_are_none(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options, fact: str
):
    assert fact in complaint(capsys, "sfm", photos, "-o", tmp_path / "capture", *options)
