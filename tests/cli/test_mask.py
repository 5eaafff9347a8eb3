"""`stylesplat mask` as it is typed."""

import errno
import json
from pathlib import Path

import pytest
import torch

from balls import BALLS, BARE, CAMERAS, SPLATS, agreement, around, box_around
from capture_files import write_ball_capture
from processes import QUICK, complaint, result, run
from stylesplat.cli.command import selection_file
from stylesplat.cli.mask import PREVIEW, RIMS
from stylesplat.io import scene_folder
from stylesplat.io.label_maps import (
    LABEL_MAPS_NAMES,
    read_label_map,
    read_names,
    write_label_map,
    write_names,
)
from stylesplat.selection.labels import render_labels
from stylesplat.verbs.export import export

pytestmark = pytest.mark.usefixtures("quick_painting")
BOX = "vase=0001.jpg:6,8,23,24"


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    return write_ball_capture(tmp_path / "photos", masks=False)


@pytest.fixture
def no_training(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object, **kwargs: object) -> None:
        raise AssertionError("work has begun")

    monkeypatch.setattr("stylesplat.masks.working_splat.fit", fail)


def test_from_a_box_to_a_painted_object(
    photos: Path, scene: Path, style: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert run("mask", photos, "--box", BOX, "--scene", scene, "--device", "cpu", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["photos"], found["names"]) == (8, {"1": "vase"})
    mask = read_label_map(photos / "object_mask" / "0001.png") == 1
    truth = render_labels(SPLATS, CAMERAS[1]) == 3
    assert (mask & truth).sum() > 0.8 * (mask | truth).sum()  # measured: 0.83

    export(SPLATS, tmp_path / "splat.ply")
    imported, styled = tmp_path / "imported", tmp_path / "styled"
    splat = tmp_path / "splat.ply"
    assert run("import", splat, photos, "-o", imported, "--device", "cpu") == 0
    assert [*scene_folder.open(imported).objects] == ["vase"]
    paint = ("stylize", imported, "--style", f"vase={style}", "-o", styled)
    assert run(*paint, "--steps", 1, *QUICK) == 0
    assert scene_folder.open(styled).painted_objects == ("vase",)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "Nothing says what to mask. Draw a box"),
        (["--method", "sam2", "--not-stroke", "a=0001.jpg:7,9"], "`strokes` means nothing"),
        (["--from", "{photos}/none"], "There is no folder or .json file"),
        (["--box", "vase=0001.jpg:1,2,3"], "Expected VIEW:x0,y0,x1,y1"),
        (["--box", "=0001.jpg:1,2,9,9"], "Cannot call an object ''"),
        (["--box", "vase=0001.jpg:nan,2,9,9"], "Expected VIEW:x0,y0,x1,y1"),
        (["--box", BOX, "--scene", "{photos}"], "not a scene"),
    ],
    ids=lambda value: "-".join(map(str, value))[:60] if isinstance(value, list) else "",
)
def test_what_makes_no_sense_is_refused_in_one_line(
    photos: Path,
    no_training: None,
    arguments: list[str],
    expected: str,
    capsys: pytest.CaptureFixture[str],
):
    assert run("mask", photos, *(each.format(photos=photos) for each in arguments)) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("stylesplat: ") and expected in lines[0]
    assert not (photos / "object_mask").exists()


def test_masks_that_are_there_are_kept(
    capture: Path, no_training: None, capsys: pytest.CaptureFixture[str]
):
    assert run("mask", capture, "--box", BOX) == 1
    kept = f"{capture}/object_mask holds label maps already. Replace them with `--overwrite`"
    assert kept in capsys.readouterr().err
    assert run("mask", capture, "--box", BOX, "--stroke", "vase=lost.jpg:1,2") == 1
    assert "No view is called 'lost.jpg'" in capsys.readouterr().err, "what is typed wrong is first"


def test_label_maps_whose_picture_cannot_be_drawn(
    photos: Path, scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    mask = ("mask", photos, "--box", BOX, "--scene", scene, "--device", "cpu", "--overwrite")
    (photos / "object_mask").mkdir()
    (photos / "object_mask" / "preview.jpg").touch()
    monkeypatch.setattr("stylesplat.figures.sheets.mask_preview", fail)
    assert run(*mask, "--json") == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["preview"] is None and json.loads(out)["photos"] == 8
    assert "There is no picture: Disk full. Free some space" in err
    assert not (photos / "object_mask" / "preview.jpg").exists(), "that of other label maps"


def test_what_an_earlier_run_said_is_replaced_and_nothing_else(
    photos: Path, scene: Path, tmp_path: Path
):
    folder, masks = photos / "object_mask", tmp_path / "masks"
    write_label_map(torch.full((36, 48), 5), folder / "0001.png")
    write_names({5: "cup"}, folder)
    (folder / "mine.png").touch()
    (folder / "0000.png").write_bytes(b"damaged")
    again = ("--device", "cpu", "--overwrite")
    assert run("mask", photos, "--box", BOX, "--scene", scene, *again) == 0
    assert read_names(folder) == {1: "vase"}
    assert {*read_label_map(folder / "0000.png").unique().tolist()} == {0, 1}
    pictures = {f"000{row}.png" for row in range(8)}
    assert {path.name for path in folder.iterdir()} == pictures | {
        "mine.png",
        LABEL_MAPS_NAMES,
        PREVIEW,
        RIMS,
    }
    labels = torch.full((36, 48), 9)
    labels[:9] = 0
    write_label_map(labels, masks / "0000.png")
    assert run("mask", photos, "--from", masks, "--overwrite") == 0
    assert {path.name for path in folder.iterdir()} == {"0000.png", "mine.png", PREVIEW}


def test_labels_without_names_are_told_by_id(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for camera in CAMERAS:
        name = Path(camera.names[0]).with_suffix(".png")
        write_label_map(render_labels(SPLATS, camera), tmp_path / "maps" / name)
    assert run("labels", scene, "--masks", tmp_path / "maps", "--device", "cpu") == 0
    said = capsys.readouterr().err
    assert "its objects are id 3 without a name, id 7 without a name" in said
    assert f"stylesplat select {scene} --name NAME --id ID" in said


def test_strokes_as_they_are_typed(photos: Path, scene: Path, capsys: pytest.CaptureFixture[str]):
    lines = ("--stroke", "vase=0001.jpg:10,12,20,12", "--not-stroke", "vase=0001.jpg:7,9")
    assert run("mask", photos, "--box", BOX, *lines, "--scene", scene, "--device", "cpu") == 0
    said = capsys.readouterr().err
    assert "preview.jpg" in said and "--drop" in said, "the picture, and what mends masks"
    labels = read_label_map(photos / "object_mask" / "0001.png")
    assert labels[12, 10:20].all() and not labels[9, 7]
    for bad in ("vase=0001.jpg:1,2,3", "vase=1,2", "vase=0001.jpg:nan,1"):
        assert run("mask", photos, "--box", BOX, "--stroke", bad) == 1
        assert "Expected VIEW:x,y,x,y" in capsys.readouterr().err


def test_a_scene_without_photos(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = tmp_path / "scene"
    scene_folder.save(BARE, folder)
    before = result(capsys, "objects", folder)
    assert before["objects"] == [] and before["sheet"] is None
    assert before["content"]["size"][2] == pytest.approx(0.7, abs=0.15)
    for name, x in (("red", 0), ("blue", 1)):
        result(capsys, "select", folder, "--name", name, f"--sphere={x},0,0,1", "--no-picture")
        selection_file(folder, name).parent.mkdir(exist_ok=True)
        selection_file(folder, name).write_bytes(b"a picture")
    box = "red=view_004:" + ",".join(map(str, around(3, "view_004")[1]))
    found = result(capsys, "mask", folder, "--box", box, "--device", "cpu")
    assert found["names"] == {"1": "red"} and found["of"] == 36
    assert (folder / "masks.jpg").is_file() and str(folder) == found["scene"]
    assert agreement(scene_folder.open(folder).objects["red"].mask, 3) > 0.8
    # Pictures of what a name no longer means are deleted
    assert not selection_file(folder, "red").exists() and selection_file(folder, "blue").is_file()
    listed = result(capsys, "objects", folder)
    (red,) = listed["objects"]
    assert red["centre"] == pytest.approx(BALLS[3][0], abs=0.1)
    assert listed["named"]["red"].items() <= red.items()
    corners = ",".join(map(str, red["box"]))
    select = ("select", folder, "--name", "again", "--no-picture", f"--box3d={corners}")
    assert result(capsys, *select)["gaussians"] > 60
    refused = complaint(capsys, "mask", folder, "--from", tmp_path)
    assert "would replace. Pass --overwrite" in refused
    assert "means nothing" in complaint(capsys, "mask", folder, "--box", box, "--scene", folder)
    assert "--overwrite" in complaint(capsys, "mask", folder, "--box", box, "-o", tmp_path)


def test_labels_of_corrected_maps(capture: Path, scene: Path, capsys: pytest.CaptureFixture[str]):
    found = result(capsys, "labels", scene, "--masks", capture / "object_mask", "--device", "cpu")
    assert found["ids"] == [3, 7, 300] and Path(found["preview"]).is_file()
    assert "no folder or .json file" in complaint(capsys, "labels", scene, "--masks", "lost")


def test_label_maps_are_corrected_in_all_photos(
    photos: Path, scene: Path, capsys: pytest.CaptureFixture[str]
):
    rest = ("--scene", scene, "--device", "cpu")
    run("mask", photos, "--box", BOX, "--keep", "vase=0001.jpg:26,2,46,5", *rest)
    folder, green = photos / "object_mask", render_labels(SPLATS, CAMERAS[2]) == 7
    before = [read_label_map(path) for path in sorted(folder.glob("*.png"))]
    assert (before[1][2:5, 26:46] == 1).all(), "a box is kept as it is drawn"
    capsys.readouterr()
    box = ",".join(map(str, box_around(green, 0)))
    found = result(capsys, "mask", photos, f"--keep=0002.jpg:{box}", *rest)
    assert found["names"] == {"1": "vase"}
    kept = [read_label_map(path) for path in sorted(folder.glob("*.png"))]
    there = [render_labels(SPLATS, camera) == 7 for camera in CAMERAS]
    shares = [float((a == 1)[b].float().mean()) for a, b in zip(kept, there, strict=True)]
    assert sum(shares) / len(shares) > 0.6, "green shows in all photos, and is the vase's now"
    assert run("mask", photos, f"--drop=vase=0002.jpg:{box}", *rest) == 0
    dropped = [read_label_map(path) for path in sorted(folder.glob("*.png"))]
    assert not dropped[2][green].any()
    for now, first in zip(dropped, before, strict=True):
        assert (now != first).float().mean() < 0.15, "the rest is as it was"
    assert "there are: vase" in complaint(capsys, "mask", photos, "--drop", f"pot=0002.jpg:{box}")
    (photos / "object_mask").rename(photos / "elsewhere")
    assert "what to mask" in complaint(capsys, "mask", photos, "--drop", f"0002.jpg:{box}")
