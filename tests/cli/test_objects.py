"""The verbs `objects`, `select`, `rename` and `delete`, and the pictures of selections."""

from dataclasses import replace
from pathlib import Path

import torch

import stylesplat as ss
from balls import BALLS, CAMERAS, SPLATS
from capture_files import ColorDetector
from processes import complaint, result, run
from stylesplat.io.images import read_image
from stylesplat.selection.labels import render_labels


def ball(id: int, radius: float) -> str:
    """A sphere around one of them, as the command line takes it."""
    return ",".join(map(str, (*BALLS[id][0], radius)))


def test_objects_are_listed_and_drawn(scene: Path, tmp_path: Path, capsys):
    sheet = tmp_path / "sheet.png"
    listed = result(capsys, "objects", scene, "-o", sheet)
    counts = {each["id"]: each["gaussians"] for each in listed["objects"]}
    assert set(counts) == {3, 7, 300}
    assert all(76 <= count <= 80 for count in counts.values()), "all but a few outliers"
    assert all(0.65 * each["gaussians"] < each["own"] for each in listed["objects"])
    assert "confidence" not in listed["objects"][0], "these labels were not lifted"
    height, width, _ = read_image(sheet).shape
    assert width > 3 * 200 and height > 200
    assert listed["sheet"] == str(sheet) and not (scene / "objects.png").exists()
    assert "--overwrite" in complaint(capsys, "objects", scene, "-o", sheet)


def test_select_by_id_and_by_point(scene: Path, capsys):
    by_id = result(capsys, "select", scene, "--name", "red", "--id", 3, "--keep-outliers")
    assert by_id["ids"] == [3] and by_id["gaussians"] == 80
    assert read_image(by_id["picture"]).shape[1] > 3 * 480, "three views of it"
    labels = render_labels(ss.open(scene).splats, CAMERAS[2])
    y, x = (labels == 7).nonzero().median(dim=0).values.tolist()
    plain = ("select", scene, "--no-picture", "--name")
    place = f"{CAMERAS.names[2]}:{x},{y}"
    assert result(capsys, *plain, "green", "--point", place)["ids"] == [7]
    box = f"{CAMERAS.names[2]}:{x - 1},{y - 1},{x + 2},{y + 2}"
    assert result(capsys, *plain, "also", "--box", box)["ids"] == [7]
    after = ss.open(scene)
    assert set(after.objects) == {"red", "green", "also"}
    assert after.objects["green"].selection.points == ((CAMERAS.names[2], (x, y)),)
    names = {e["id"]: e["names"] for e in result(capsys, "objects", scene)["objects"]}
    assert names == {3: ["red"], 7: ["green", "also"], 300: []}


def test_options_that_are_repeated_append(scene: Path, capsys):
    plain = ("select", scene, "--no-picture", "--name")
    both = result(capsys, *plain, "both", "--id", 3, 7)
    for name, id in (("red", 3), ("green", 7)):
        result(capsys, *plain, name, "--id", id)
    plus = result(capsys, *plain, "c", "--plus", "red", "--plus", "green")
    assert plus["gaussians"] == both["gaussians"] and plus["plus"] == ["red", "green"]
    none = ("--minus", "red", "--minus", "green")
    assert "Nothing is left" in complaint(capsys, *plain, "d", "--plus", "both", *none)
    spheres = [f"--sphere={ball(id, 0.3)}" for id in (3, 7)]
    alone = [result(capsys, *plain, "e", each)["gaussians"] for each in spheres]
    assert result(capsys, *plain, "f", *spheres)["gaussians"] == sum(alone)


def test_select_by_text(scene: Path, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "stylesplat.selection.resolve.load_detector", lambda *a: asked.append(a) or ColorDetector()
    )
    text = ("--text", "blue", "--model", "a/b", "--no-picture")
    found = result(capsys, "select", scene, "--name", "it", *text)
    assert found["ids"] == [300] and found["scores"].keys() == {"300"}
    assert asked[0][0] == "a/b"


def test_a_picture_that_cannot_be_written(scene: Path, tmp_path: Path, capsys):
    """The selection is made all the same, unless the picture would be written elsewhere."""
    (scene / "selections").write_text("mine")
    found = result(capsys, "select", scene, "--name", "red", "--id", 3)
    assert found["picture"] is None and ss.open(scene).objects.keys() == {"red"}
    assert (scene / "selections").read_text() == "mine"
    (scene / "selections").unlink()
    (scene / "selections").symlink_to(tmp_path)
    line = complaint(capsys, "select", scene, "--name", "green", "--id", 7)
    assert "leads out of the folder" in line and not [*tmp_path.glob("*.png")]
    assert ss.open(scene).objects.keys() == {"red"}


def test_the_picture_comes_last_if_there_is_one(scene: Path, capsys):
    above = SPLATS.means.clone()
    above[200:280] = torch.tensor([0.0, 0.0, 60.0])  # the red ball, above all cameras
    ss.save(ss.Scene(replace(SPLATS, means=above), CAMERAS), scene / "other")
    old = scene / "other" / "selections" / "red.png"
    old.parent.mkdir()
    old.write_bytes(b"an earlier selection")
    assert run("select", scene / "other", "--name", "red", "--id", 3) == 0
    assert "red shows in none of the views" in capsys.readouterr().err and not old.exists()
    assert run("select", scene / "other", "--name", "green", "--id", 7) == 0
    answer, following, *_, last = capsys.readouterr().err.splitlines()
    assert answer.startswith("green: ") and following.startswith("Next: stylesplat stylize ")
    assert last.startswith(f"Picture: {old.with_name('green.png')}, the selected"), "drawn last"


def test_rename_and_delete(scene: Path, capsys):
    (scene / "notes.txt").write_text("mine")
    first = result(capsys, "select", scene, "--name", "red", "--id", 3)
    picture = Path(first["picture"]).read_bytes()
    renamed = result(capsys, "rename", scene, "red", "vase")
    assert renamed["name"] == "vase" and renamed["was"] == "red" and renamed["ids"] == [3]
    assert Path(renamed["picture"]).read_bytes() == picture
    assert not Path(first["picture"]).exists()
    assert [*ss.open(scene).objects] == ["vase"]
    assert "Names: vase" in complaint(capsys, "rename", scene, "red", "pot")
    assert "Names: vase" in complaint(capsys, "delete", scene, "red")
    deleted = result(capsys, "delete", scene, "vase")
    assert deleted == {"scene": str(scene), "deleted": "vase", "names": []}
    assert not Path(renamed["picture"]).exists() and not ss.open(scene).objects
    assert (scene / "notes.txt").read_text() == "mine"


def test_rename_and_delete_into_a_new_scene(scene: Path, tmp_path: Path, capsys):
    for name, id in (("red", 3), ("green", 7)):
        result(capsys, "select", scene, "--name", name, "--id", id, "--no-picture")
    before = {file: file.read_bytes() for file in scene.rglob("*") if file.is_file()}
    renamed = result(capsys, "rename", scene, "red", "vase", "-o", tmp_path / "renamed")
    assert renamed["scene"] == str(tmp_path / "renamed") and renamed["picture"] is None
    assert [*ss.open(tmp_path / "renamed").objects] == ["vase", "green"]
    assert run("delete", scene, "red", "-o", tmp_path / "left") == 0
    assert "Names: green" in capsys.readouterr().err
    assert [*ss.open(tmp_path / "left").objects] == ["green"]
    assert {file: file.read_bytes() for file in scene.rglob("*") if file.is_file()} == before
    assert "--overwrite" in complaint(capsys, "delete", scene, "green", "-o", tmp_path / "left")
    again = ("-o", tmp_path / "left", "--overwrite")
    assert run("rename", tmp_path / "left", "green", "jug", *again) == 0, "upon itself"
    assert [*ss.open(tmp_path / "left").objects] == ["jug"]
