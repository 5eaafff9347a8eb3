from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import BLUE, PICKS, RED, TRAINED, assert_same_splats
from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import open
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.io.splats.splat_ply import read_splat_ply
from stylesplat.scene.objects import SceneObject
from stylesplat.selection.objects import cut_out, part_mask
from stylesplat.verbs.export import export, export_each

pytestmark = pytest.mark.usefixtures("quick_painting")


def test_what_no_file_can_hold(tmp_path: Path):
    splats, path = random_splats(), tmp_path / "a.ply"
    for name, degree, message in (
        ("a.ply.gz", None, r"unknown suffix .*Use \.ply, .*\.spz, .*\.sog, \.glb, .* or \.html"),
        ("a.splat", 1, r"a \.splat has one colour .*Leave the degree out"),
        ("a.ply", 4, r"no degree of colour 4\. Use 0, 1, 2, 3"),
    ):
        with pytest.raises(StyleSplatError, match=message):
            export(splats, tmp_path / name, sh_degree=degree)
    with pytest.raises(StyleSplatError, match=r"units from the origin.*Export a \.ply"):
        export(replace(splats, means=splats.means * 1e8), tmp_path / "a.spz")
    assert not any(tmp_path.iterdir())
    path.write_text("old")
    with pytest.raises(StyleSplatError, match=r"a\.ply exists.*--overwrite.*overwrite=True"):
        export(splats, path)
    assert path.read_text() == "old"
    export(splats, path, overwrite=True)
    assert len(read_splat_ply(path)) == 200


@pytest.mark.parametrize("suffix", ["ply", "compressed.ply", "spz", "sog", "glb"])
@pytest.mark.parametrize("degree", [0, 2])
def test_degrees_that_are_asked_for(tmp_path: Path, suffix: str, degree: int):
    splats, path = random_splats(), tmp_path / f"a.{suffix}"
    export(splats, path, sh_degree=degree)
    found, bands = read_splats(path), (degree + 1) ** 2 - 1
    assert found.sh_degree == degree
    if suffix == "ply":
        assert torch.equal(found.shN, splats.shN[:, :bands])
    # Bands that nobody has are 0
    export(replace(splats, shN=splats.shN[:, :0]), path, sh_degree=degree, overwrite=True)
    assert read_splats(path).shN.shape[1] == bands


# Objects alone, left out, or each in a file of its own


def test_parts_fit_together_again(tmp_path: Path):
    whole = TRAINED.splats
    assert export(TRAINED, tmp_path / "two.ply", objects=["red", "blue"]) == 160
    assert export(TRAINED, tmp_path / "others.ply", without=["red", "blue"]) == len(whole) - 160
    two, others = (read_splat_ply(tmp_path / f"{name}.ply") for name in ("two", "others"))
    mine = RED | BLUE
    assert torch.equal(two.means, whole.means[mine]) and torch.equal(two.shN, whole.shN[mine])
    assert torch.equal(others.means, whole.means[~mine])
    export(TRAINED, tmp_path / "red.ply", objects=["both"], without=["green"])
    assert torch.equal(read_splat_ply(tmp_path / "red.ply").means, whole.means[RED])


def test_each_object_has_a_file_and_so_has_the_rest(tmp_path: Path):
    plain = replace(TRAINED.splats, identities=None, classifier=None)
    one = replace(TRAINED, base=plain, objects={"red": TRAINED.objects["red"]})
    files = export_each(one, tmp_path / "parts", suffix=".splat")
    assert [path.name for path in files] == ["red.splat", "rest.splat"]
    assert {*(tmp_path / "parts").iterdir()} == {*files}
    files = export_each(TRAINED, tmp_path / "four")
    assert [path.stem for path in files] == [*PICKS, "3", "7", "300", "rest"]
    found = {path.stem: read_splat_ply(path).means for path in files}
    assert torch.equal(found["blue"], TRAINED.splats.means[BLUE])
    (tmp_path / "four" / "mine.txt").write_text("mine")
    with pytest.raises(StyleSplatError, match="something else"):
        export_each(TRAINED, tmp_path / "four")
    export_each(one, tmp_path / "four", overwrite=True)
    assert (tmp_path / "four" / "mine.txt").read_text() == "mine"


def test_a_part_of_a_painted_scene_knows_what_was_before(stack: Path, tmp_path: Path):
    scene = open(stack / "twice")
    part = cut_out(scene, part_mask(scene, ["red"]))
    own = scene.objects["red"].mask
    assert_same_splats(part.base, scene.base[own])
    assert_same_splats(part.splats, scene.splats[scene.to_splats(own)])
    assert part.painted_objects == ("red",), "of the other nothing is there"
    rest = cut_out(scene, part_mask(scene, without=["both"]))
    assert rest.layers == ()
    export(scene, tmp_path / "green.html", objects=["green"])
    assert (tmp_path / "green.html").stat().st_size > 10_000


def test_what_cannot_be_cut_out_is_told(tmp_path: Path):
    with pytest.raises(StyleSplatError, match="no object 'vase'"):
        export(TRAINED, tmp_path / "a.ply", objects=["vase"])
    red = TRAINED.objects["red"]
    empty = {**TRAINED.objects, "red": replace(red, mask=torch.zeros_like(red.mask))}
    with pytest.raises(StyleSplatError, match="red: it has no Gaussians"):
        export(replace(TRAINED, objects=empty), tmp_path / "a.ply", objects=["red"])
    with pytest.raises(StyleSplatError, match="Nothing is left"):
        export(TRAINED, tmp_path / "a.ply", objects=["red"], without=["both"])
    with pytest.raises(StyleSplatError, match="Splats alone have no objects"):
        export(TRAINED.splats, tmp_path / "a.ply", objects=["red"])
    plain = replace(TRAINED.splats, identities=None, classifier=None)
    with pytest.raises(StyleSplatError, match="has no objects"):
        export_each(replace(TRAINED, base=plain, objects={}), tmp_path / "parts")
    called = replace(TRAINED, objects={"rest": SceneObject(RED)})
    with pytest.raises(StyleSplatError, match="An object is called 'rest'"):
        export_each(called, tmp_path / "parts")
    assert not [*tmp_path.iterdir()]
