"""The verb `import`."""

from pathlib import Path

import numpy as np

from processes import complaint, result, run


def test_import_and_select_by_shape(scene: Path, capture: Path, tmp_path: Path, capsys):
    splat, out = tmp_path / "balls.ply", tmp_path / "imported"
    assert run("export", scene, splat) == 0
    metrics = result(capsys, "import", splat, capture, "-o", out, "--device", "cpu")
    assert metrics["psnr"] > 30
    found = result(capsys, "select", out, "--name", "red", "--box3d=-1.1,-0.4,0.02,-0.3,0.4,0.7")
    assert found["gaussians"] >= 79
    less = result(capsys, "select", out, "--name", "rest", "--id", 3, 7, "--minus", "red")
    assert 0 < less["gaussians"] <= 81


def test_import_with_labels(scene: Path, tmp_path: Path, capsys):
    splat, out = tmp_path / "balls.ply", tmp_path / "imported"
    assert run("export", scene, splat) == 0
    np.save(tmp_path / "labels.npy", [0] * 200 + [3] * 240)
    labels = ("--labels", tmp_path / "labels.npy")
    metrics = result(capsys, "import", splat, *labels, "-o", out, "--up", "z")
    assert metrics["label_ids"] == 1 and metrics["unlabelled_gaussians"] == 200
    assert result(capsys, "select", out, "--name", "it", "--id", 3)["gaussians"] > 220
    bad = ("import", splat, "--labels", tmp_path / "lost.npy", "-o", tmp_path / "other")
    assert "lost.npy" in complaint(capsys, *bad) and not (tmp_path / "other").exists()
    both = ("import", splat, scene, *labels, "--masks", tmp_path, "-o", tmp_path / "other")
    assert "Pass one of them" in complaint(capsys, *both)
