"""The verbs `stylize` and `adjust`."""

import json
from pathlib import Path

import pytest
import torch

import stylesplat as ss
from processes import QUICK, complaint, result, run
from stylesplat.selection.labels import pick

PAINTED = ("sh0", "shN", "opacities")  # what a Gaussian changes that is painted or lies beneath

pytestmark = pytest.mark.usefixtures("quick_painting")


def test_the_scene_is_there_before_it_is_measured(
    scene: Path, style: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("stylesplat.verbs.stylize.measure_painted", interrupted)
    out = scene.parent / "interrupted"
    arguments = ("--style", f"3={style}", "--steps", 1, *QUICK)
    assert run("stylize", scene, "-o", out, *arguments, "--form", 0.3, "--scale", 3) != 0
    styled = ss.open(out)
    assert styled.painted_objects == ("3",)
    recipe = json.loads((out / "recipe.json").read_text())
    assert (recipe["settings"]["form"], recipe["settings"]["scale"]) == (0.3, 3)
    assert styled.metrics["steps"] == 1 and "nnfm_after" not in styled.metrics


def test_options_replace_what_a_recipe_says(scene: Path, styled: Path, capsys):
    out, recipe = scene.parent / "again", ("--recipe", styled / "recipe.json")
    again = ("stylize", scene, "-o", out, *recipe, "--steps", 1, *QUICK)
    assert "--recipe" in complaint(capsys, *again, "--style", "3=a.png")
    assert run(*again, "--intensity", 0.7) == 0
    assert [layer.strength for layer in ss.open(out).layers] == [0.7, 0.7]
    assert {layer.settings["steps"] for layer in ss.open(out).layers} == {1}


def test_stylize_changes_only_the_colours_of_the_object(scene: Path, style: Path, capsys):
    picked = ("--id", 3, "--keep-outliers", "--no-picture")
    assert run("select", scene, "--name", "red", *picked) == 0
    out = scene.parent / "styled"
    styles = ("--style", f"red={style}", "--steps", 3)
    metrics = result(capsys, "stylize", scene, "-o", out, *styles, "--device", "cpu")
    before, styled = ss.open(scene).splats, ss.open(out)
    after = styled.splats[torch.arange(len(before))]
    new = len(styled.splats) - len(before)
    assert before.identities is not None
    painted = before.identities[:, 1] > 0
    for name, tensor in before.tensors().items():
        kept = ~painted if name in PAINTED else torch.ones_like(painted)
        assert torch.equal(tensor[kept], after.tensors()[name][kept]), name
    changed = (before.sh0 != after.sh0).any(dim=(1, 2))
    assert changed.any() and not changed[~painted].any(), "by how much each is the object's"
    assert new > 80, "a canvas lies on it"
    assert new < metrics["changed_gaussians"] <= 80 + new
    assert set(metrics["nnfm_before"]) == set(metrics["nnfm_after"]) == {"red"}
    assert metrics["steps"] == 3 and metrics["precision"].startswith(("float", "bfloat"))
    assert set(metrics["seconds_by_object"]) == {"red"}
    assert styled.painted_objects == ("red",)
    assert torch.equal(styled.base.sh0, before.sh0)
    recipe = json.loads((out / "recipe.json").read_text())
    assert len(recipe["objects"][0]["sha256"]) == 64
    assert recipe["settings"]["steps"] == 3
    assert styled.metrics["train"] == {"psnr": 30.0}


def test_adjust_blends_exactly_and_can_be_undone(scene: Path, styled: Path, capsys):
    kept = [styled / "base.ply", *(styled / "layers").iterdir()]
    files = {path: path.read_bytes() for path in kept}
    (styled / "notes.txt").write_text("mine")
    before, half = ss.open(scene).splats, ss.open(styled).splats
    base = ss.open(scene).splats.sh0
    capsys.readouterr()
    shown = result(capsys, "adjust", styled, "--intensity", 1)
    assert shown["intensity"] == {"3": 1.0, "7": 1.0}
    full = ss.open(styled).splats
    own = slice(len(before))
    assert torch.allclose(full.sh0[own] - base, 2 * (half.sh0[own] - base), atol=1e-6)
    assert (full.sh0 - half.sh0).abs().max() > 0.01
    assert run("adjust", styled, "--intensity", 0) == 0
    assert torch.equal(ss.open(styled).splats.sh0, base)
    assert (styled / "notes.txt").read_text() == "mine"
    assert {path: path.read_bytes() for path in kept} == files, "of layers nothing is written"
    undone = styled.with_name("undone")
    assert run("adjust", styled, "--undo", "-o", undone) == 0
    for name in ("splats.ply", "identities.safetensors", "picks.safetensors"):
        assert (undone / name).read_bytes() == (scene / name).read_bytes()
    assert len(before) == len(half), "it is painted on its own Gaussians"


def test_adjust_one_object_into_a_new_scene(styled: Path, tmp_path: Path, capsys):
    before, out = (styled / "splats.ply").read_bytes(), tmp_path / "loud"
    capsys.readouterr()
    shown = result(capsys, "adjust", styled, "--object", 3, "--intensity", 1.5, "-o", out)
    assert shown["intensity"] == {"3": 1.5, "7": 0.5}
    assert (styled / "splats.ply").read_bytes() == before
    half, loud = ss.open(styled).splats, ss.open(out).splats
    changed = (loud.sh0 != half.sh0).flatten(1).any(dim=1)
    assert changed.any() and not (changed & ~pick(half, object_id=3, remove_outliers=False)).any()
    assert run("adjust", out, "--intensity", 0.5) == 0
    assert torch.allclose(ss.open(out).splats.sh0, half.sh0, atol=1e-6)
    undone = result(capsys, "adjust", out, "--object", 3, "--undo", "-o", tmp_path / "undone")
    assert undone["intensity"] == {"7": 0.5}, "the other one stays"
    unstyled = ("adjust", out, "--object", 300, "--intensity", 1)
    assert "Styled objects: 3, 7" in complaint(capsys, *unstyled)
    shown = result(capsys, "adjust", styled, "--form", 0.7, "--object", 3)
    assert shown["form"] == {"3": 0.7, "7": 1.0}
    assert shown["intensity"] == {"3": 0.5, "7": 0.5}
    assert [layer.form for layer in ss.open(styled).layers] == [0.7, 1.0]
    assert "use 0 to 1.5" in complaint(capsys, "adjust", styled, "--form", 2)
    assert "--form F" in complaint(capsys, "adjust", styled)


def test_a_mesh_is_painted_by_the_same_verb(style: Path, tmp_path: Path, capsys):
    import trimesh

    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    ball, out = tmp_path / "ball.ply", tmp_path / "painted.glb"
    wrong = ("stylize", ball, "--style", style, "-o", out)
    assert "--recipe" in complaint(capsys, *wrong, "--recipe", "a.yaml")
    assert "NAME=IMAGE" in complaint(capsys, *wrong, "--style", f"a={style}")
    (tmp_path / "ball.fbx").touch()
    of_another = ("stylize", tmp_path / "ball.fbx", "--style", style, "-o", out)
    assert "ball.fbx as a mesh" in complaint(capsys, *of_another)
    settings = ("--quality", "draft", "--steps", 1, "--texture-size", 64, "--device", "cpu")
    found = result(capsys, *wrong, *settings)
    assert (found["faces"], found["unwrapped"], found["pictures"]) == (320, 320, [64])
    assert found["mesh"] == str(out) and out.is_file()
