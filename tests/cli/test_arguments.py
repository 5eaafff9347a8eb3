"""From what the user types to a command: help, values, what is repeated."""

from pathlib import Path
from typing import Any

import pytest

from stylesplat.cli import VERBS, main
from stylesplat.cli.arguments import help_texts, read_command
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.options import options_of
from stylesplat.structure_from_motion.config import SfmConfig
from stylesplat.stylization.config import RecolorConfig, StyleConfig
from stylesplat.training.config import TrainConfig

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
    assert any(line.startswith(f"Example: stylesplat {verb} ") for line in page.splitlines())
    assert "None" not in page and "False" not in page and "repeatable" not in page


@pytest.mark.parametrize(
    ("verb", "config"),
    [
        ("stylize", StyleConfig),
        ("recolor", RecolorConfig),
        ("train", TrainConfig),
        ("export", MeshConfig),
        ("sfm", SfmConfig),
    ],
)
def test_settings_have_the_help_and_the_defaults_of_their_config(verb: str, config: type, capsys):
    page = " ".join(printed(capsys, verb, "--help").replace("│", "").split())
    for name, option in options_of(config).items():
        shown = "" if option.default in (None, ()) else f" (default: {option.default})"
        shown = "" if isinstance(option.default, bool) else shown
        assert option.research or help_texts(config)[name] + shown in page


@pytest.mark.parametrize(
    ("arguments", "facts"),
    [
        ((*STYLIZE, "--intensity", "70%"), ("--intensity", "70%")),
        ((*STYLIZE, "--steps", "many"), ("--steps", "many")),
        ((*STYLIZE, "--color", "x"), ("--color", "'x'", "style", "keep", "blend", "free")),
        ((*STYLIZE, "--region", "1", "2"), ("--region", "4 values")),
        ((*STYLIZE, "--setps", "3"), ("--setps", "Perhaps you meant: --steps")),
        (("select", "s", "--name", "a", "--id=b"), ("--id", "b")),
        (("train",), ("CAPTURE", "-o PATH")),
        (("rename", "a"), ("OLD", "NEW")),
        (("train", "my", "photos", "-o", "y"), ("photos",)),
        (("trane",), ("trane", "Available subcommands: demo, check, sfm")),
    ],
    ids=" ".join,
)
def test_wrong_usage(arguments: tuple[str, ...], facts: tuple[str, ...], capsys):
    said = " ".join(printed(capsys, *arguments, status=2).replace("│", " ").split())
    prog = f"stylesplat {arguments[0]}" if arguments[0] in VERBS else "stylesplat"
    assert f"{prog} --help" in said
    assert all(fact in said for fact in facts)


def test_what_is_repeated_appends():
    select = parsed("select", "garden", "--name", "a", "--id", "1", "2", "--id", "3")
    assert select.id == ((1, 2), (3,))
    select = parsed("select", "garden", "--name", "a", "--plus", "b", "--plus", "c", "d")
    assert select.plus == (("b",), ("c", "d"))
    spheres = ("--sphere", "-1,0,2,3", "--sphere", "x:1,2,3")
    assert parsed("select", "garden", "--name", "a", *spheres).sphere == ("-1,0,2,3", "x:1,2,3")
    assert parsed(*STYLIZE, "--steps", "1", "--steps", "2").settings == {"steps": 2}


def test_commands_hold_what_was_given():
    assert parsed(*STYLIZE).settings == {} and parsed(*STYLIZE).style == ()
    typed = ("--region", "1", "2", "-3", "4", "--intensity", "1")
    assert parsed(*STYLIZE, *typed).settings == {"region": (1, 2, -3, 4), "intensity": 1}
    trained = parsed("train", "a", "-o", "b", "--max_seconds", "3").settings
    assert trained == {"max_seconds": 3, "refine_poses": False}

    for name in ("--stroke-size", "--scale"):
        assert parsed(*STYLIZE, name, "3").settings == {"scale": 3}
    mask = parsed("mask", "garden", "--from", "masks.json")
    assert (mask.source, mask.box, mask.json) == (Path("masks.json"), (), False)
    render = parsed("render", "garden", "-o", "a.mp4", "--json")
    assert (render.output, render.views, render.json) == (Path("a.mp4"), "all", True)
    assert parsed("train", "a", "-o", "b", "--refine-poses").settings["refine_poses"]
