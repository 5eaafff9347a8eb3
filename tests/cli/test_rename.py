"""The verbs `rename` and `delete`."""

from pathlib import Path

import stylesplat as ss
from processes import complaint, result, run


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


def test_rename_what_has_no_picture(scene: Path, capsys):
    result(capsys, "select", scene, "--name", "red", "--id", 3, "--no-picture")
    assert result(capsys, "rename", scene, "red", "vase")["picture"] is None


def test_into_a_new_scene(scene: Path, tmp_path: Path, capsys):
    """The one that it is made of stays as it is; pictures are of what has that name there."""
    red = result(capsys, "select", scene, "--name", "red", "--id", 3)
    result(capsys, "select", scene, "--name", "green", "--id", 7)
    before = {file: file.read_bytes() for file in scene.rglob("*") if file.is_file()}
    renamed = result(capsys, "rename", scene, "red", "vase", "-o", tmp_path / "renamed")
    assert renamed["scene"] == str(tmp_path / "renamed")
    assert [*ss.open(tmp_path / "renamed").objects] == ["vase", "green"]
    assert renamed["picture"] == str(tmp_path / "renamed" / "selections" / "vase.png")
    assert Path(renamed["picture"]).read_bytes() == Path(red["picture"]).read_bytes()
    left = result(capsys, "delete", scene, "red", "-o", tmp_path / "left")
    assert left["scene"] == str(tmp_path / "left") and left["names"] == ["green"]
    assert [*ss.open(tmp_path / "left").objects] == ["green"]
    assert {file: file.read_bytes() for file in scene.rglob("*") if file.is_file()} == before
    assert "--overwrite" in complaint(capsys, "delete", scene, "green", "-o", tmp_path / "left")
    again = ("-o", tmp_path / "left", "--overwrite")
    assert result(capsys, "rename", scene, "green", "pot", *again)["name"] == "pot"
    assert run("rename", tmp_path / "left", "pot", "jug", *again) == 0, "and upon itself"
    assert [*ss.open(tmp_path / "left").objects] == ["red", "jug"]
    assert [file.name for file in (tmp_path / "left" / "selections").iterdir()] == ["jug.png"]
    capsys.readouterr()
    assert run("rename", scene, "green", "pot", "-o", tmp_path / "other") == 0
    assert f"stylize {tmp_path / 'other'} --style pot" in capsys.readouterr().err
