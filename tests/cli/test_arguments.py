"""From what the user types to a command: help, values, what is repeated."""

import re
from pathlib import Path
from typing import Any

import pytest

from stylesplat.__main__ import main
from stylesplat.cli.__init__ import VERBS
from stylesplat.cli.arguments import read_command

STYLIZE = ("stylize", "garden", "-o", "wave")


def parsed(verb: str, *arguments: str) -> Any:
    return read_command(VERBS[verb], arguments, f"stylesplat {verb}")


def printed(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 0) -> str:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert (stopped.value.code or 0) == status
    out, err = capsys.readouterr()
    assert not (err if status == 0 else out)
    return out + err


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_verb(verb: str, capsys):
    page = printed(capsys, verb, "--help")
    lines = page.splitlines()
    assert any(line.startswith(f"Example: stylesplat {verb} ") for line in lines)
    assert "None" not in page and "False" not in page and "repeatable" not in page
    assert not any(line != line.rstrip() for line in lines)
    assert not re.search(r"\n\n   ", page), "no row is empty within a group"


def test_few_options_come_first(capsys):
    first, more = printed(capsys, "stylize", "--help").split("more options")
    for option in ("SCENE", "-o PATH", "--style", "--intensity"):
        assert option in first and f"  {option}" not in more
    for option in ("--max-memory", "--seed", "--json", "--overwrite"):
        assert option in more and f"  {option}" not in first
    assert "OBJECT is a name\n" not in more, "lines are filled"


@pytest.mark.parametrize("width", [60, 70, 79, 80, 81, 97, 100])
def test_no_row_of_help_is_empty(width: int, capsys, monkeypatch):
    """Where a text fills its line to the last column as well."""
    monkeypatch.setenv("COLUMNS", str(width))
    for verb in VERBS:
        page = printed(capsys, verb, "--help")
        assert not re.search(r"\n\n   ", page)
        long = [line for line in page.splitlines() if len(line) > width]
        assert all(line.startswith(("Example:", "usage:")) for line in long)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((*STYLIZE, "--intensity", "70%"), "--intensity: expected a number, got '70%'."),
        ((*STYLIZE, "--steps", "many"), "--steps: expected a whole number, got 'many'."),
        ((*STYLIZE, "--color", "x"), "--color: expected style, keep, blend or free, got 'x'."),
        ((*STYLIZE, "--region", *"12x4"), "--region: expected a whole number, got '1 2 x 4'."),
        (("select", "s", "--name", "a", "--id"), "--id: expected a whole number, got nothing."),
        ((*STYLIZE, "--stroke-size", "big"), "--stroke-size: expected a number, got 'big'."),
        ((*STYLIZE, "--steps"), "--steps: expected a whole number, got nothing."),
        ((*STYLIZE, "--region", "1", "2"), "--region: expected 4 values, got 2."),
        ((*STYLIZE, "--json=3"), "--json takes no value, got '3'."),
        (("select", "s", "--name", "a", "--id=b"), "--id: expected a whole number, got 'b'."),
    ],
)
def test_values_that_do_not_fit(arguments: tuple[str, ...], line: str, capsys):
    said = printed(capsys, *arguments, status=2)
    assert said == f"stylesplat {arguments[0]}: {line} See `stylesplat {arguments[0]} --help`.\n"


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("train", "CAPTURE and -o are missing in `stylesplat train CAPTURE -o PATH`."),
        ("train -o=x --seed 1", "CAPTURE is missing in `stylesplat train CAPTURE -o PATH`."),
        ("select --id 3 4 -- x", "--name is missing in `stylesplat select SCENE --name TEXT`."),
        ("rename a", "OLD and NEW are missing in `stylesplat rename SCENE OLD NEW`."),
        ("train X --stepz 3", "there is no option --stepz. Is it --steps?"),
        (
            "train X -o y --max_gausians=3",
            "there is no option --max_gausians. Is it --max-gaussians?",
        ),
        ("stylize S --qualities", "there is no option --qualities. Is it --quality?"),
        ("train X -o y -q", "there is no option -q."),
        ("train my photos -oy", "there is no place for 'photos'; a name with spaces needs quotes."),
    ],
)
def test_options_that_are_missing_or_unknown(arguments: str, line: str, capsys):
    verb, *_ = arguments.split()
    said = printed(capsys, *arguments.split(), status=2)
    assert said == f"stylesplat {verb}: {line} See `stylesplat {verb} --help`.\n"


def test_what_is_repeated_appends():
    select = parsed("select", "garden", "--name", "a", "--id", "1", "2", "--id", "3")
    assert select.id == (1, 2, 3)
    select = parsed("select", "--name", "a", "--plus", "b", "--plus", "c", "d", "garden")
    assert (select.plus, select.scene) == (("b", "c", "d"), Path("garden"))
    select = parsed(
        "select", "garden", "--name", "a", "--sphere", "-1,0,2,3", "--sphere", "x:1,2,3"
    )
    assert select.sphere == ("-1,0,2,3", "x:1,2,3")
    assert parsed(*STYLIZE).style == () and parsed(*STYLIZE).steps is None
    assert parsed(*STYLIZE, "--steps", "1", "--steps", "2").steps == 2, "one value: the last"


def test_the_size_of_strokes_has_two_names():
    """`--scale` is what it was called before."""
    for name in ("--stroke-size", "--scale"):
        assert parsed(*STYLIZE, name, "3").scale == 3
    assert parsed(*STYLIZE, "--scale", "3", "--stroke-size", "1").scale == 1


@pytest.mark.parametrize(
    "option",
    [
        "pattern",
        "layers",
        "texture",
        "smoothness",
        "view-dependence",
        "canvas",
        "max-growth",
        "hard",
    ],
)
def test_settings_that_only_python_has_are_no_options(option: str, capsys):
    said = printed(capsys, *STYLIZE, f"--{option}", "3", status=2)
    assert f"there is no option --{option}." in said


def test_values_are_what_commands_hold():
    region = parsed(*STYLIZE, "--region", "1", "2", "-3", "4", "--max_memory", "2").region
    assert region == (1, 2, -3, 4)
    mask = parsed("mask", "garden", "--from", "masks.json")
    assert (mask.source, mask.box, mask.json) == (Path("masks.json"), (), False)
    render = parsed("render", "garden", "-o", "a.mp4", "--json")
    assert (render.output, render.views, render.json) == (Path("a.mp4"), "all", True)
