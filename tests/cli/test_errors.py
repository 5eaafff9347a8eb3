"""What ends a command early: one line on stderr, an exit status, and no result that is lost."""

import errno
import os
import shlex
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import torch

from balls import CAMERAS, SPLATS
from processes import complaint
from scenes import assert_same
from stylesplat.cli import main
from stylesplat.cli.arguments import parse_style
from stylesplat.cli.command import BUG, OUT_OF_MEMORY, new_scene, unused
from stylesplat.cli.objects import Objects
from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.io.scene_folder import open
from stylesplat.options import BOX, LINE, SPHERE
from stylesplat.scene.scene import Scene

VIEW = CAMERAS.names[0]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
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
        (["stylize", "{scene}", "--style", "3={style}", "-o", "{tmp}"], "--overwrite"),
        (["train", "{tmp}", "-o", "{tmp}/y", "--steps", "0"], "with steps 0"),
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


def test_places_and_styles_are_parsed(tmp_path: Path):
    assert BOX.parse("a:b.jpg:1,2,3,4.5") == ("a:b.jpg", (1.0, 2.0, 3.0, 4.5))
    assert SPHERE.parse("0,1,2,3") == ("", (0.0, 1.0, 2.0, 3.0))
    assert LINE.parse("a.jpg:1,2,3,4")[1] == (1.0, 2.0, 3.0, 4.0)
    for wrong in ("a.jpg:1,2", "a.jpg:1,2,3,b", "1,2,3,4", "a.jpg:1,2,3,nan", ""):
        with pytest.raises(StyleSplatError, match=f"Expected VIEW:x0,y0,x1,y1, got '{wrong}'"):
            BOX.parse(wrong)
    assert parse_style("vase=a=b.jpg,b.jpg") == ("vase", (Path("a=b.jpg"), Path("b.jpg")))
    for wrong in ("=b.jpg", "vase", "vase=", "vase=a.jpg,", "vase=a.jpg,,b.jpg"):
        with pytest.raises(StyleSplatError, match=f"OBJECT=IMAGE.*got '{wrong}'"):
            parse_style(wrong)
    (both := tmp_path / "day,night.jpg").touch()
    assert parse_style(f"vase={both}") == ("vase", (both,)), "a comma may belong to the name"
    many = ",".join(["picture.jpg"] * 99)  # longer than names of files may be
    assert len(parse_style(f"vase={many}")[1]) == 99


OF_CUDA = (
    "CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has a total capacity of 7.79 GiB of "
    "which 1.19 GiB is free. Of the allocated memory 5.10 GiB is allocated by PyTorch."
)


def failing(error: Exception):
    def fail(*_: object) -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    ("fail", "expected"),
    [
        (lambda: np.empty(2**58, np.uint8), OUT_OF_MEMORY),
        (lambda: torch.empty(2**58, dtype=torch.uint8), OUT_OF_MEMORY),
        (failing(torch.OutOfMemoryError("CUDA out of memory. Tried to ...")), OUT_OF_MEMORY),
        (failing(torch.OutOfMemoryError(OF_CUDA)), "2.00 GiB more were needed, and 1.19 GiB of 7."),
        (failing(OSError(errno.ENOSPC, "No space", "a")), "Disk full: a. Free some space"),
        (failing(PermissionError(errno.EACCES, "Not allowed", "a")), "Not allowed: a. Mend"),
        (failing(OSError("image file is truncated\nmore")), "image file is truncated. Mend"),
    ],
)
def test_a_machine_that_is_too_small(fail, expected: str, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr(Objects, "run", lambda _: fail())
    assert expected in complaint(capsys, "objects", "x")


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Objects, "run", failing(ValueError("what")))
    with pytest.raises(ValueError) as caught:
        main(["objects", "x"])
    assert caught.value.__notes__ == [BUG]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_results_that_nobody_takes(scene: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    def ends(stdout: int) -> int:
        status = -1
        with suppress(OSError), os.fdopen(stdout, "w") as closed:  # raised once more at the end
            monkeypatch.setattr("sys.stdout", closed)
            status = main(["export", str(scene), str(scene / "x.splat"), "--json", "--overwrite"])
        return status

    reader, writer = os.pipe()
    os.close(reader)
    assert ends(writer) == 141, "as `stylesplat ... | head` may"
    assert ends(os.open("/dev/full", os.O_WRONLY)) == 1
    assert capsys.readouterr().err == "stylesplat: Disk full. Free some space and try again.\n"


def test_a_scene_is_saved_elsewhere_in_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))
    with new_scene(tmp_path / "scene", overwrite=False) as save:
        save(Scene(SPLATS, CAMERAS))
    assert (tmp_path / "scene" / "scene.json").is_file() and not [*elsewhere.iterdir()]
    garden = tmp_path / "garden"
    with pytest.raises(StyleSplatError, match="is a file") as raised:  # since the scene was begun
        with new_scene(garden, overwrite=False) as save:
            garden.touch()
            save(Scene(SPLATS, CAMERAS))
    (place,) = elsewhere.iterdir()
    assert f"The scene is in {place / 'garden'}: move it from there." in str(raised.value)
    assert_same(open(place / "garden"), open(tmp_path / "scene"))


def test_places_that_are_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    scene = tmp_path / "garden"
    scene.mkdir()
    assert unused(scene, ".ply") == tmp_path / "garden.ply"
    (tmp_path / "garden.ply").touch()
    (tmp_path / "garden-2.ply").touch()
    assert unused(scene, ".ply") == tmp_path / "garden-3.ply"
    (tmp_path / "garden-it's").mkdir()
    command = shell_command("export", "my garden", unused(scene, "-it's"))
    assert shlex.split(command)[1:] == ["export", "my garden", f"{tmp_path}/garden-it's-2"]
    monkeypatch.chdir(scene)
    assert unused(Path(), ".spz") == tmp_path / "garden.spz"
