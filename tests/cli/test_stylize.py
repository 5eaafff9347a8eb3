"""The verb `stylize`."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import stylesplat as ss
from command_line import QUICK, result, run
from stylesplat.io.scene_folder import save

PAINT = ("sh0", "shN", "opacities")  # what changes of a Gaussian that is painted

pytestmark = pytest.mark.usefixtures("quick_painting")


def test_the_scene_is_there_before_it_is_measured(
    scene: Path, style: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("stylesplat.verbs.stylize.measure_painted", interrupted)
    out = scene.parent / "interrupted"
    arguments = ("--style", f"3={style}", "--steps", 1, "--hard", *QUICK, "--max-growth", 1)
    assert run("stylize", scene, "-o", out, *arguments, "--texture", 0.3) != 0
    styled = ss.open(out)
    assert styled.painted_objects == ("3",)
    recipe = json.loads((out / "recipe.json").read_text())
    assert recipe["settings"]["texture"] == 0.3, "a number"
    assert styled.metrics["steps"] == 1 and "nnfm_after" not in styled.metrics


def test_label_maps_are_looked_at_where_the_photos_are_there(
    scene: Path, capture: Path, style: Path, capsys
):
    save(replace(ss.open(scene), capture=capture), scene, overwrite=True)
    rest = ("--style", f"3={style}", "--steps", 1, *QUICK)
    found = result(capsys, "stylize", scene, "-o", scene.with_name("painted"), *rest)
    assert found["stain_pixels"] == 0
    assert ss.open(scene.with_name("painted")).metrics["stain_pixels"] == 0


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
        "--hard",
        *QUICK,
    )
    assert (scene / "selections").exists() and not (out / "selections").exists(), "left behind"
    before, styled = ss.open(scene).splats, ss.open(out)
    after = styled.splats[torch.arange(len(before))]
    assert before.identities is not None
    painted = (before.identities[:, 1] + before.identities[:, 2]) > 0
    for name, tensor in before.tensors().items():
        kept = ~painted if name in PAINT else torch.ones_like(painted)
        assert torch.equal(tensor[kept], after.tensors()[name][kept]), name
    assert (before.sh0[painted] != after.sh0[painted]).any(dim=(1, 2)).all()
    assert metrics["changed_gaussians"] == 160
    assert len(styled.splats) == len(before), "it is painted on its own Gaussians"
    assert set(metrics["nnfm_before"]) == set(metrics["nnfm_after"]) == {"red", "green"}
    assert metrics["steps"] == 6 and metrics["precision"].startswith(("float", "bfloat"))
    assert set(metrics["seconds_by_object"]) == {"red", "green"}
    assert styled.painted_objects == ("red", "green")
    assert torch.equal(styled.unpainted.sh0, before.sh0)
    recipe = json.loads((out / "recipe.json").read_text())
    assert len(recipe["objects"][0]["sha256"]) == 64
    assert recipe["settings"]["hard"] is True
    assert styled.metrics["train"] == {"psnr": 30.0}
