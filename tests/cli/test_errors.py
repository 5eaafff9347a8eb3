"""Bad input gets one line on stderr and status 1."""

from pathlib import Path

import pytest

from balls import CAMERAS
from processes import complaint
from stylesplat.cli.arguments import parse_place, parse_style
from stylesplat.errors import StyleSplatError

VIEW = CAMERAS.names[0]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["objects", "{tmp}"], "not a scene"),
        (["train", "{tmp}/none", "-o", "{tmp}/x"], "none"),
        (["select", "{scene}", "--name", "x", "--id", "99"], "99 does not exist"),
        (
            ["select", "{scene}", "--name", "x", "--id", "0"],
            " select {scene} --name NAME --background",
        ),
        (["select", "{scene}", "--name", "x"], "Select with --id"),
        (["select", "{scene}", "--name", "x", "--point", "7,8"], "VIEW:x,y"),
        (
            ["select", "{scene}", "--name", "x", "--point", VIEW + ":0,0"],
            "`stylesplat objects {scene}`",
        ),
        (["select", "{scene}", "--name", "x", "--box", VIEW + ":0,0,1,1"], "objects {scene}"),
        (["select", "{scene}", "--name", "x", "--id", "3", "--model", "a/b"], "Pass --text"),
        (["select", "{scene}", "--name", "x", "--text", "a", "--model", "{tmp}/no"], "is no model"),
        (["stylize", "{scene}", "--style", "red", "-o", "{tmp}/y"], "OBJECT=IMAGE"),
        (["adjust", "{scene}", "--intensity", "0.5"], "is not styled"),
        (["stylize", "{scene}", "--style", "red={style}", "-o", "{tmp}/y"], "no object 'red'"),
        (["stylize", "{scene}", "--style", "3={tmp}/none.png", "-o", "{tmp}/y"], "none.png"),
        (["stylize", "{scene}", "--style", "3={style}", "-o", "{tmp}"], "--overwrite"),
        (["train", "{tmp}", "-o", "{tmp}/y", "--steps", "0"], "must exceed 0"),
        (["render", "{scene}", "-o", "{tmp}/y", "--downscale", "0"], "positive factor"),
        (["render", "{scene}", "-o", "{tmp}/y", "--what", "smell"], "smell"),
        (["render", "{scene}", "-o", "{tmp}"], "--overwrite"),
        (["evaluate", "{scene}"], "Pass --capture"),
        (["export", "{scene}", "{tmp}/out.obj"], ".obj"),
    ],
    ids=lambda value: "-".join(map(str, value))[:50] if isinstance(value, list) else "",
)
def test_one_line_and_status_1(
    arguments: list[str], expected: str, scene: Path, style: Path, capsys
):
    places = {"scene": scene, "tmp": scene.parent, "style": style}
    before = {p: p.stat().st_mtime_ns for p in scene.parent.rglob("*") if p.is_file()}
    features = ["--features", "compact"] if arguments[0] == "stylize" else []
    line = complaint(capsys, *(a.format(**places) for a in arguments), *features)
    assert expected.format(**places) in line
    after = {p: p.stat().st_mtime_ns for p in scene.parent.rglob("*") if p.is_file()}
    assert after == before, "nothing of the user's is changed"


def test_places_and_styles_are_parsed():
    box = "VIEW:x0,y0,x1,y1"
    assert parse_place("a:b.jpg:1,2,3,4.5", box) == ("a:b.jpg", (1.0, 2.0, 3.0, 4.5))
    assert parse_place("0,1,2,3", box, "x,y,z,RADIUS") == ("", (0.0, 1.0, 2.0, 3.0))
    assert parse_place("a.jpg:1,2,3,4", "VIEW:x,y,x,y,...")[1] == (1.0, 2.0, 3.0, 4.0)
    for wrong in ("a.jpg:1,2", "a.jpg:1,2,3,b", "1,2,3,4", "a.jpg:1,2,3,nan", ""):
        with pytest.raises(StyleSplatError, match=f"Expected {box}, got '{wrong}'"):
            parse_place(wrong, box)
    assert parse_style("vase=a=b.jpg") == ("vase", (Path("a=b.jpg"),))
    assert parse_style("vase=a.jpg,b.jpg") == ("vase", (Path("a.jpg"), Path("b.jpg")))
    for wrong in ("=b.jpg", "vase", "vase=", "vase=a.jpg,", "vase=a.jpg,,b.jpg"):
        with pytest.raises(StyleSplatError, match=f"OBJECT=IMAGE.*got '{wrong}'"):
            parse_style(wrong)


def test_a_comma_may_belong_to_a_pictures_name(tmp_path: Path):
    both = tmp_path / "day,night.jpg"
    split = (tmp_path / "day", Path("night.jpg"))
    assert parse_style(f"vase={both}") == ("vase", split)
    both.touch()
    assert parse_style(f"vase={both}") == ("vase", (both,))
    many = ",".join(["picture.jpg"] * 99)  # longer than names of files may be
    assert len(parse_style(f"vase={many}")[1]) == 99
