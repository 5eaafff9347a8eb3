"""The picture that `stylesplat select` draws of what it found."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from balls import CAMERAS, SPLATS
from processes import result, run
from stylesplat.cli.objects import selection_file
from stylesplat.cli.results import Answer
from stylesplat.cli.select import Select
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.images import read_image
from stylesplat.scene.scene import Scene


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    scene_folder.save(Scene(SPLATS, CAMERAS), tmp_path / "scene")
    return tmp_path / "scene"


def selected(folder: Path, name: str, *ids: int) -> dict[str, Any]:
    """What is answered; and then the rest is done."""
    found = Select(folder, name, id=(ids,)).run()
    if isinstance(found, Answer):
        found.rest()
    picture = selection_file(folder, name)
    return {**found, "picture": picture if picture.exists() else None}


def test_the_answer_comes_before_the_picture(scene: Path, said: list[str]):
    found = Select(scene, "red", id=((3,),)).run()
    assert isinstance(found, Answer)
    assert scene_folder.open(scene).objects.keys() == {"red"}, "it is selected"
    picture = scene / "selections" / "red.png"
    assert found["picture"] is None and not picture.exists()
    assert not any("Picture" in line for line in Select(scene, "red").words(found))
    assert not said
    found.rest()
    (line,) = said
    assert line.startswith(f"Picture: {picture}, the selected Gaussians in colour")
    assert read_image(picture).shape[1] > 3 * 480


def test_colors_that_are_not_read_are_not_lost(scene: Path):
    before = (scene / "splats.ply").read_bytes()
    assert scene_folder.open(scene).splats.shN.shape[1] == 15
    found = selected(scene, "red", 3)
    assert found["picture"] is not None and (scene / "splats.ply").read_bytes() == before


def test_a_picture_that_cannot_be_written(scene: Path, capsys):
    """What was asked for is done and told all the same."""
    (scene / "selections").write_text("mine")
    found = result(capsys, "select", scene, "--name", "red", "--id", 3)
    assert found["picture"] is None, "no program is sent to look for it"
    assert found["ids"] == [3] and scene_folder.open(scene).objects.keys() == {"red"}
    assert (scene / "selections").read_text() == "mine"


def test_no_two_names_share_a_picture(scene: Path):
    names = ["vase", "Vase", "a.b", "a-b", "a b", ".", "..", "花瓶", "花", "x" * 99, "x" * 100]
    pictures = [selected(scene, name, 3)["picture"] for name in names]
    assert len({str(path).lower() for path in pictures}) == len(names)
    assert {path.parent for path in pictures} == {scene / "selections"}
    assert sorted(pictures) == sorted((scene / "selections").iterdir())
    assert scene_folder.open(scene).objects.keys() == set(names)


def test_what_shows_in_no_view_has_no_picture(scene: Path, said: list[str]):
    shown = selected(scene, "red", 3)
    above = SPLATS.means.clone()
    above[200:280] = torch.tensor([0.0, 0.0, 60.0])  # the red ball, above all cameras
    scene_folder.save(Scene(replace(SPLATS, means=above), CAMERAS), scene / "other")
    (scene / "other" / "selections").mkdir()
    old = scene / "other" / "selections" / "red.png"
    old.write_bytes(shown["picture"].read_bytes())
    found = selected(scene / "other", "red", 3)
    assert found["picture"] is None and found["gaussians"] == 80
    assert not old.exists(), "the picture of an earlier choice would be wrong"
    assert "red shows in none of the views" in "\n".join(said)


def test_no_picture_is_drawn_through_a_link_that_leads_outside(scene: Path, tmp_path: Path):
    (tmp_path / "elsewhere").mkdir()
    (scene / "selections").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StyleSplatError, match="leads out of the folder"):
        selected(scene, "red", 3)
    assert not [*(tmp_path / "elsewhere").iterdir()]
    assert not scene_folder.open(scene).objects, "it is refused before it is done"


def test_a_picture_in_a_new_scene(scene: Path, tmp_path: Path, capsys):
    """And what is called so in the other one keeps its own."""
    first, new = selected(scene, "it", 7), tmp_path / "new"
    old = first["picture"].read_bytes()
    found = result(capsys, "select", scene, "--name", "it", "--id", 3, "-o", new)
    assert found["scene"] == str(new) and found["picture"] == str(selection_file(new, "it"))
    assert selection_file(new, "it").read_bytes() != old == first["picture"].read_bytes()
    assert scene_folder.open(scene).objects["it"].how["ids"] == [7]
    assert scene_folder.open(new).objects["it"].how["ids"] == [3]
    late = ("--overwrite", "-o", new)
    assert run("select", scene, "--name", "it", "--id", 300, *late, "--no-picture") == 0
    assert f"stylize {new} --style it" in capsys.readouterr().err
    assert not selection_file(new, "it").exists(), "that of an earlier scene would be wrong"
    assert run("select", scene, "--name", "it", "--id", 300, *late) == 0
    assert selection_file(new, "it").is_file(), "it is drawn after the answer"
