"""The verbs `rename` and `delete`."""

from pathlib import Path

import stylesplat as ss
from command_line import complaint, result


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
    assert result(capsys, "delete", scene, "vase") == {"deleted": "vase", "names": []}
    assert not Path(renamed["picture"]).exists() and not ss.open(scene).objects
    assert (scene / "notes.txt").read_text() == "mine"


def test_rename_what_has_no_picture(scene: Path, capsys):
    result(capsys, "select", scene, "--name", "red", "--id", 3, "--no-picture")
    assert result(capsys, "rename", scene, "red", "vase")["picture"] is None
