"""The verb `adjust`."""

from pathlib import Path

import torch

import stylesplat as ss
from processes import complaint, result, run
from stylesplat.selection.pick import pick


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
    assert run("adjust", styled, "--intensity", 0.5) == 0
    assert torch.allclose(ss.open(styled).splats.sh0, half.sh0, atol=1e-6)
    assert run("adjust", styled, "--intensity", 0) == 0
    assert torch.equal(ss.open(styled).splats.sh0, base)
    assert run("adjust", styled, "--intensity", 1) == 0
    assert torch.equal(ss.open(styled).splats.sh0, full.sh0)
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


def test_form_is_adjusted_by_itself(styled: Path, capsys):
    before = ss.open(styled).splats
    capsys.readouterr()
    shown = result(capsys, "adjust", styled, "--form", 0.7, "--object", 3)
    assert shown["form"] == {"3": 0.7, "7": 1.0}
    assert shown["intensity"] == {"3": 0.5, "7": 0.5}
    found = ss.open(styled)
    assert [layer.form for layer in found.layers] == [0.7, 1.0]
    assert found.layers[0].relief.any() or torch.equal(found.splats.sh0, before.sh0)
    assert "use 0 to 1.5" in complaint(capsys, "adjust", styled, "--form", 2)
    assert "--form F" in complaint(capsys, "adjust", styled)
