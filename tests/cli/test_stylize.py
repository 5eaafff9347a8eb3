"""The verb `stylize`."""

import json
from pathlib import Path

import pytest
import torch

import stylesplat as ss
from processes import QUICK, result, run

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


def test_stylize_changes_only_the_colours_of_the_objects(scene: Path, style: Path, capsys):
    assert run("select", scene, "--name", "red", "--id", 3, "--keep-outliers") == 0
    assert run("select", scene, "--name", "green", "--id", 7, "--keep-outliers") == 0
    out = scene.parent / "styled"
    metrics = result(
        capsys,
        "stylize",
        scene,
        "-o",
        out,
        "--style",
        f"red={style}",
        "--style",
        f"green={style}",
        "--steps",
        3,
        "--device",
        "cpu",
    )
    assert (scene / "selections").exists() and not (out / "selections").exists(), "left behind"
    before, styled = ss.open(scene).splats, ss.open(out)
    after = styled.splats[torch.arange(len(before))]
    new = len(styled.splats) - len(before)
    assert before.identities is not None
    painted = (before.identities[:, 1] + before.identities[:, 2]) > 0
    for name, tensor in before.tensors().items():
        kept = ~painted if name in PAINTED else torch.ones_like(painted)
        assert torch.equal(tensor[kept], after.tensors()[name][kept]), name
    changed = (before.sh0 != after.sh0).any(dim=(1, 2))
    assert changed.any() and not changed[~painted].any(), "by how much each is the object's"
    assert new > 160, "a canvas lies on them"
    assert new < metrics["changed_gaussians"] <= 160 + new
    assert set(metrics["nnfm_before"]) == set(metrics["nnfm_after"]) == {"red", "green"}
    assert metrics["steps"] == 6 and metrics["precision"].startswith(("float", "bfloat"))
    assert set(metrics["seconds_by_object"]) == {"red", "green"}
    assert styled.painted_objects == ("red", "green")
    assert torch.equal(styled.unpainted.sh0, before.sh0)
    recipe = json.loads((out / "recipe.json").read_text())
    assert len(recipe["objects"][0]["sha256"]) == 64
    assert recipe["settings"]["steps"] == 3
    assert styled.metrics["train"] == {"psnr": 30.0}
