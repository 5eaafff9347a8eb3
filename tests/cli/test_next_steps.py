"""Commands that people are told can be pasted: quoted, and into places that are free."""

import shlex
from pathlib import Path

import pytest

from stylesplat.cli.results import next_lines, object_commands, stylize_command, unused
from stylesplat.scene.arguments import pasted


def test_names_with_spaces_and_quotes_are_quoted():
    command = pasted("export", Path("my garden"), "it's.ply")
    assert shlex.split(command) == ["stylesplat", "export", "my garden", "it's.ply"]


def test_a_place_that_is_free(tmp_path: Path):
    scene = tmp_path / "garden"
    assert unused(scene, ".ply") == tmp_path / "garden.ply"
    (tmp_path / "garden.ply").touch()
    (tmp_path / "garden-2.ply").touch()
    assert unused(scene, ".ply") == tmp_path / "garden-3.ply"
    (tmp_path / "garden-painted").mkdir()
    assert unused(scene, "-painted") == tmp_path / "garden-painted-2"
    assert f"{tmp_path / 'garden-painted-2'}" in stylize_command(scene, "vase")


def test_beside_the_folder_one_is_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "garden").mkdir()
    monkeypatch.chdir(tmp_path / "garden")
    assert unused(Path(), ".ply") == tmp_path / "garden.ply"


@pytest.mark.parametrize(
    ("names", "labelled", "expected"),
    [(["vase"], True, "--style vase="), ([], True, "objects"), ([], False, "--sphere")],
)
def test_the_way_to_an_object(names: list[str], labelled: bool, expected: str):
    assert expected in " ".join(object_commands(Path("garden"), names, labelled=labelled))


def test_a_splat_alone_is_masked_in_its_views():
    commands = object_commands(Path("garden"), [], labelled=False, photos=False)
    assert commands[-1] == "stylesplat mask garden --box NAME=VIEW:x0,y0,x1,y1"


def test_one_command_a_line():
    assert next_lines("a", "b") == ["Next: a", "      b"]
