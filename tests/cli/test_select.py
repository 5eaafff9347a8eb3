"""The verb `select`."""

from pathlib import Path

import stylesplat as ss
from balls import BALLS, CAMERAS
from capture_files import ColorDetector
from processes import complaint, result
from stylesplat.io.images import read_image
from stylesplat.selection.identities import render_labels


def ball(id: int, radius: float) -> str:
    """A sphere around one of them, as the command line takes it."""
    return ",".join(map(str, (*BALLS[id][0], radius)))


def test_select_by_id_and_by_point(scene: Path, capsys):
    by_id = result(capsys, "select", scene, "--name", "red", "--id", 3, "--keep-outliers")
    assert by_id["ids"] == [3] and by_id["gaussians"] == 80
    assert read_image(by_id["picture"]).shape[1] > 3 * 480, "three views of it"
    labels = render_labels(ss.open(scene).splats, CAMERAS[2])
    y, x = (labels == 7).nonzero().median(dim=0).values.tolist()
    place = f"{CAMERAS.names[2]}:{x},{y}"
    assert result(capsys, "select", scene, "--name", "green", "--point", place)["ids"] == [7]
    box = f"{CAMERAS.names[2]}:{x - 1},{y - 1},{x + 2},{y + 2}"
    assert result(capsys, "select", scene, "--name", "also", "--box", box)["ids"] == [7]
    after = ss.open(scene)
    assert set(after.objects) == {"red", "green", "also"}
    assert after.objects["green"].how["points"][0][0] == CAMERAS.names[2]
    names = {e["id"]: e["names"] for e in result(capsys, "objects", scene)["objects"]}
    assert names == {3: ["red"], 7: ["green", "also"], 300: []}


def test_options_that_are_repeated_append(scene: Path, capsys):
    both = result(capsys, "select", scene, "--name", "both", "--id", 3, 7)
    assert result(capsys, "select", scene, "--name", "b", "--id", 3, "--id", 7)["ids"] == [3, 7]
    for name, id in (("red", 3), ("green", 7)):
        result(capsys, "select", scene, "--name", name, "--id", id)
    plus = result(capsys, "select", scene, "--name", "c", "--plus", "red", "--plus", "green")
    assert plus["gaussians"] == both["gaussians"] and plus["plus"] == ["red", "green"]
    none = ("--minus", "red", "--minus", "green")
    line = complaint(capsys, "select", scene, "--name", "d", "--plus", "both", *none)
    assert "Nothing is left" in line
    for option, one, other in (
        ("--sphere", ball(3, 0.3), ball(7, 0.3)),
        ("--box3d", "-9,-9,-9,0,9,9", "0,-9,-9,9,9,9"),
    ):
        alone = [
            result(capsys, "select", scene, "--name", "e", f"{option}={shape}")["gaussians"]
            for shape in (one, other)
        ]
        both = (f"{option}={one}", f"{option}={other}")
        assert result(capsys, "select", scene, "--name", "f", *both)["gaussians"] == sum(alone)


def test_select_by_text(scene: Path, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "stylesplat.verbs.select.load_detector", lambda *a: asked.append(a) or ColorDetector()
    )
    found = result(capsys, "select", scene, "--name", "it", "--text", "blue", "--model", "a/b")
    assert found["ids"] == [300] and found["scores"].keys() == {"300"}
    assert asked[0][0] == "a/b"
