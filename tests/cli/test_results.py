"""How commands end: what cannot be saved in its place, and commands that can be pasted."""

import shlex
from pathlib import Path

import pytest

from balls import CAMERAS, SPLATS
from scenes import assert_same
from stylesplat.cli.results import save_or_rescue, stylize_command, unused
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import open
from stylesplat.scene.arguments import pasted
from stylesplat.scene.scene import Scene

SCENE = Scene(SPLATS, CAMERAS)


def test_a_scene_is_saved_elsewhere_in_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))
    save_or_rescue(SCENE, tmp_path / "scene", overwrite=False)
    assert (tmp_path / "scene" / "scene.json").is_file() and not [*elsewhere.iterdir()]
    (tmp_path / "file").touch()
    with pytest.raises(StyleSplatError, match=r"Cannot write|is a file") as raised:
        save_or_rescue(SCENE, tmp_path / "file" / "garden", overwrite=False)
    (place,) = elsewhere.iterdir()
    assert f"The scene is in {place / 'garden'}: move it from there." in str(raised.value)
    assert_same(open(place / "garden"), open(tmp_path / "scene"))


def test_names_with_spaces_and_quotes_are_quoted():
    command = pasted("export", Path("my garden"), "it's.ply")
    assert shlex.split(command) == ["stylesplat", "export", "my garden", "it's.ply"]


def test_places_that_are_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    scene = tmp_path / "garden"
    scene.mkdir()
    assert unused(scene, ".ply") == tmp_path / "garden.ply"
    (tmp_path / "garden.ply").touch()
    (tmp_path / "garden-2.ply").touch()
    assert unused(scene, ".ply") == tmp_path / "garden-3.ply"
    (tmp_path / "garden-painted").mkdir()
    assert f"{tmp_path / 'garden-painted-2'}" in stylize_command(scene, "vase")
    monkeypatch.chdir(scene)
    assert unused(Path(), ".spz") == tmp_path / "garden.spz"
