"""The verb `check`: what it says of a whole capture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture_files import save_noise, sfm_record, with_tracks, write_ball_capture, write_capture
from stylesplat.io.captures.capture_folder import load, write_sfm
from stylesplat.photo_libraries import pycolmap
from stylesplat.structure_from_motion.diagnostics import CaptureReport
from stylesplat.verbs.sfm import check


def finding(report: CaptureReport, what: str) -> tuple[str, str]:
    found = {each.what: each for each in report.findings}[what]
    return found.verdict, found.line


@pytest.fixture
def posed(tmp_path: Path) -> Path:
    return write_capture(tmp_path / "capture", count=4)


def test_photos_without_a_pose_are_named(posed: Path):
    assert finding(check(load(posed)), "posed") == ("good", "4 of 4 photos have a pose.")
    save_noise(posed / "images" / "more" / "lost.JPG")
    (posed / "images" / "notes.txt").write_text("no photo")
    verdict, line = finding(check(load(posed)), "posed")
    assert verdict == "fair"
    assert line.startswith("4 of 5 photos have a pose, not more/lost.JPG. Take more photos")


def test_what_sfm_wrote_down_says_why(posed: Path):
    record = sfm_record(
        source="photos",
        given=9,
        registered=4,
        left_out={"IMG_9.jpg": "nearly the same as IMG_8.jpg"},
        unregistered={"IMG_3.jpg": "no overlap"},
    )
    write_sfm(record, posed)
    _, line = finding(check(load(posed)), "posed")
    assert line.startswith(
        "4 of 5 photos have a pose, not IMG_3.jpg (no overlap); 1 more were left out. Take more"
    )


def test_photos_of_another_place_need_none_in_between(posed: Path):
    unregistered = {f"{n}.jpg": "shows another place, with 2 other photos" for n in "abc"}
    record = sfm_record(source="photos", given=7, registered=4, unregistered=unregistered)
    write_sfm(record, posed)
    _, line = finding(check(load(posed)), "posed")
    assert line.endswith(
        "Pose each place in a folder of its own, or take photos that connect them."
    )


def test_a_reconstruction_counts_where_there_is_one(posed: Path):
    assert "overlap" not in {each.what for each in check(load(posed)).findings}, "no tracks"
    with_tracks(posed, [[1, 2, 3]] * 60 + [[3, 4]] * 20)
    report = check(load(posed))
    assert finding(report, "reprojection error")[0] == "poor"
    assert finding(report, "track length") == (
        "poor",
        "a point is seen in 2.6 photos on average. Photos overlap little: take them in smaller "
        "steps, each with two thirds of the last.",
    )
    assert report.weak == ("001.png",), "the photo of id 4"
    assert finding(report, "overlap")[1].startswith("few points connect 001.png with the others")


def test_a_capture_in_memory(tmp_path: Path):
    whole = load(write_ball_capture(tmp_path, masks=False))
    report = check(replace(whole, path=None))
    assert "posed" not in {each.what for each in report.findings}
    assert finding(report, "photos")[0] == "poor"
    assert finding(report, "sides") == (
        "good",
        "seen from all sides, every 45 degrees or closer.",
    )
    assert finding(report, "points")[0] == "poor"
    none = check(replace(whole, points=None, point_colors=None))
    assert finding(none, "points")[1].startswith("there are no points. Training starts from random")


def test_what_lies_far_from_all_else_is_named(posed: Path, tmp_path: Path):
    assert "outliers" not in {each.what for each in check(load(posed)).findings}
    model = pycolmap.Reconstruction(posed / "sparse" / "0")
    image = next(each for each in model.images.values() if each.name == "002.png")
    far = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([-5e4, 3e4, 8e4]))
    image.frame.set_cam_from_world(image.camera_id, far)
    model.write(posed / "sparse" / "0")
    in_file = load(posed)
    for capture in (in_file, in_file.without_outliers()):
        report = check(capture)
        verdict, line = finding(report, "outliers")
        assert verdict == "fair" and "002.png" in line
        assert finding(report, "posed") == ("good", "4 of 4 photos have a pose.")
