"""The verb `import`."""

from pathlib import Path

from command_line import result, run


def test_import_and_select_by_shape(scene: Path, capture: Path, tmp_path: Path, capsys):
    splat, out = tmp_path / "balls.ply", tmp_path / "imported"
    assert run("export", scene, splat) == 0
    metrics = result(capsys, "import", splat, capture, "-o", out, "--device", "cpu")
    assert metrics["psnr"] > 30
    found = result(capsys, "select", out, "--name", "red", "--box3d=-1.1,-0.4,0.02,-0.3,0.4,0.7")
    assert found["gaussians"] >= 79
    less = result(capsys, "select", out, "--name", "rest", "--id", 3, 7, "--minus", "red")
    assert 0 < less["gaussians"] <= 81
