"""The verb `export`."""

from pathlib import Path

import torch

from balls import SPLATS
from command_line import run
from stylesplat.io.splats.splat_ply import read_splat_ply


def test_export_keeps_every_bit(scene: Path, tmp_path: Path):
    assert run("export", scene, tmp_path / "out.ply") == 0
    exported = read_splat_ply(tmp_path / "out.ply")
    assert torch.equal(exported.means, SPLATS.means)
    assert torch.equal(exported.sh0, SPLATS.sh0)
    assert run("export", scene, tmp_path / "out.ply") == 1, "never overwrites by itself"
    assert run("export", scene, tmp_path / "out.ply", "--overwrite") == 0
    assert run("export", scene, tmp_path / "out.splat") == 0
