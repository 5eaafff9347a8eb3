"""The verbs `export` and `import`."""

import json
from pathlib import Path

import pytest
import torch

from balls import SPLATS
from processes import complaint, result, run
from stylesplat.io.splats.splat_ply import read_splat_ply


def test_export_keeps_every_bit(scene: Path, tmp_path: Path, capsys):
    assert run("export", scene, tmp_path / "out.ply") == 0
    exported = read_splat_ply(tmp_path / "out.ply")
    assert torch.equal(exported.means, SPLATS.means)
    assert torch.equal(exported.sh0, SPLATS.sh0)
    assert run("export", scene, tmp_path / "out.ply") == 1, "never overwrites by itself"
    assert run("export", scene, tmp_path / "out.ply", "--overwrite") == 0
    assert run("export", scene, "-o", tmp_path / "out.splat") == 0
    alone = complaint(capsys, "export", scene, tmp_path / "a.ply", "--repaint")
    assert "--repaint" in alone and "--mesh" in alone
    for both in ((), ("a.ply", "-o", "b.ply")):
        assert "Name one file" in complaint(capsys, "export", scene, *both)


def test_export_makes_a_page(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run("export", scene, tmp_path / "out.html") == 0
    said = capsys.readouterr().err
    assert "out.html: 440 Gaussians, 0.0 MB." in said
    assert "exists" in complaint(capsys, "export", scene, tmp_path / "out.html")
    assert run("export", scene, tmp_path / "out.html", "--overwrite", "--sh-degree", 0) == 0


def test_export_cuts_objects_out(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run("export", scene, tmp_path / "red.ply", "--object", 3, "--object", 7, "--json") == 0
    count = json.loads(capsys.readouterr().out)["gaussians"]
    assert 0 < count < len(SPLATS) and len(read_splat_ply(tmp_path / "red.ply")) == count
    assert run("export", scene, tmp_path / "others.ply", "--without", 3, "--without", 7) == 0
    assert len(read_splat_ply(tmp_path / "others.ply")) == len(SPLATS) - count
    capsys.readouterr()
    assert run("export", scene, "--each", tmp_path / "parts") == 0
    assert "parts: 3.ply, 7.ply" in capsys.readouterr().err
    both = ("--each", tmp_path / "more", "--object", 3)
    assert "--object means nothing with --each" in complaint(capsys, "export", scene, *both)


def test_objects_go_out_and_come_back(scene: Path, tmp_path: Path, capsys):
    assert run("export", scene, tmp_path / "a.spz", "--sidecar") == 0
    assert "Objects: " in capsys.readouterr().err
    labels = ("--labels", tmp_path / "a.spz.objects.npz")
    found = result(capsys, "import", tmp_path / "a.spz", *labels, "-o", tmp_path / "b", "--up", "z")
    assert found["label_ids"] == 3
    lost = ("import", tmp_path / "a.spz", "--labels", tmp_path / "lost.npy", "-o", tmp_path / "c")
    assert "lost.npy" in complaint(capsys, *lost) and not (tmp_path / "c").exists()
    both = ("import", tmp_path / "a.spz", scene, *labels, "--masks", tmp_path, "-o", tmp_path / "c")
    assert "--masks means nothing with --labels" in complaint(capsys, *both)
    assert result(capsys, "export", scene, tmp_path / "picks.npz", "--object", 7)["objects"] == 1
    rows = ("--rows", tmp_path / "picks.npz")
    picked = result(capsys, "select", tmp_path / "b", "--name", "it", *rows, "--no-picture")
    assert picked["rows"] == [str(tmp_path / "picks.npz")] and picked["gaussians"] > 70
    idle = ("export", scene, tmp_path / "c.npz", "--sidecar")
    assert "means nothing for a list of objects" in complaint(capsys, *idle)
    assert "--sidecar means nothing" in complaint(
        capsys, "export", scene, "--each", tmp_path, "--sidecar"
    )


def test_what_another_program_made_of_a_scene(scene: Path, tmp_path: Path, capsys):
    assert run("export", scene, tmp_path / "part.ply", "--without", 3) == 0
    capsys.readouterr()
    again = ("import", tmp_path / "part.ply", "--like", scene)
    assert run(*again, "-o", tmp_path / "again") == 0
    said = capsys.readouterr().err
    assert f"of {scene}, 0 are new" in said and "Objects: " not in said
    assert result(capsys, "select", tmp_path / "again", "--name", "it", "--id", 7)["gaussians"] > 70
    assert "Leave the capture" in complaint(capsys, *again, "--labels", scene, "-o", tmp_path / "c")
    folder = ("import", tmp_path / "part.ply", "--like", tmp_path)
    assert "not a scene" in complaint(capsys, *folder, "-o", tmp_path / "c")
