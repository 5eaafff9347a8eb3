"""Checkpoints of gsplat and of nerfstudio's splatfacto, which are read without running anything."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from scenes import random_splats, write_checkpoint
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.scene.splats import Splats, rgb_from_sh0

NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN")
SPLATS = random_splats(20, sh_degree=2)


def assert_same(found: Splats, expected: Splats = SPLATS) -> None:
    for name in NAMES:
        assert torch.equal(getattr(found, name), getattr(expected, name)), name


def splatfacto(prefix: str, splats: Splats = SPLATS, **others: Any) -> dict[str, Any]:
    parameters = {name: getattr(splats, name) for name in ("means", "quats", "scales")}
    parameters |= {"opacities": splats.opacities[:, None], "features_dc": splats.sh0[:, 0]}
    parameters |= {"features_rest": splats.shN}
    pipeline = {prefix + name: value for name, value in parameters.items()}
    pipeline["datamanager.train_camera_optimizer"] = torch.zeros(3)
    return {"step": 29999, "pipeline": pipeline, "optimizers": {}, **others}


def test_gsplats_checkpoint(tmp_path: Path):
    write_checkpoint(SPLATS, tmp_path / "ckpt_6999_rank0.pt")
    assert_same(read_splats(tmp_path / "ckpt_6999_rank0.pt"))


def test_other_gpus_files_are_named(tmp_path: Path, said: list[str]):
    for rank in range(2):
        write_checkpoint(SPLATS, tmp_path / f"ckpt_6999_rank{rank}.pt")
    read_splats(tmp_path / "ckpt_6999_rank0.pt")
    assert len(said) == 1 and "ckpt_6999_rank1.pt" in said[0]


@pytest.mark.parametrize("prefix", ["_model.gauss_params.", "_model."])
def test_splatfactos_checkpoint(tmp_path: Path, prefix: str):
    torch.save(splatfacto(prefix), tmp_path / "step-000029999.ckpt")
    assert_same(read_splats(tmp_path / "step-000029999.ckpt"))


def test_splatfactos_plain_colours_are_logits(tmp_path: Path):
    plain = replace(SPLATS, shN=SPLATS.shN[:, :0])
    torch.save(splatfacto("_model.gauss_params.", plain), tmp_path / "a.ckpt")
    colors = rgb_from_sh0(read_splats(tmp_path / "a.ckpt").sh0)
    torch.testing.assert_close(colors, SPLATS.sh0.sigmoid())


class Trap:
    """What a pickle calls when it is loaded."""

    def __reduce__(self) -> Any:
        return os.mkdir, ("touched",)


def test_a_pickle_that_would_run_code_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    torch.save(splatfacto("_model.", config=Trap()), tmp_path / "a.ckpt")
    with pytest.raises(StyleSplatError, match=r"more than tensors"):
        read_splats(tmp_path / "a.ckpt")
    assert not Path("touched").exists()


def stretched() -> torch.Tensor:
    """Claims ten billion rows, and holds one."""
    return torch.zeros(1, 3).expand(10**10, 3)


parameters = {name: getattr(SPLATS, name) for name in NAMES}
BAD: dict[str, tuple[Any, str]] = {
    "another network": ({"state_dict": {"conv.weight": torch.zeros(3)}}, "state_dict"),
    "a list": ([1, 2], "list"),
    "a parameter is missing": ({"splats": {"means": SPLATS.means}}, "quats"),
    "an appearance network": ({"splats": {"features": torch.zeros(3)}}, "appearance"),
    "rows of another number": ({"splats": parameters | {"quats": SPLATS.quats[:7]}}, "quats"),
    "bands of no degree": ({"splats": parameters | {"shN": SPLATS.shN[:, :5]}}, "5 higher bands"),
    "claims more than it holds": ({"splats": parameters | {"means": stretched()}}, "means"),
}


@pytest.mark.parametrize("name", BAD)
def test_other_checkpoints_are_refused_in_one_line(tmp_path: Path, name: str):
    content, fact = BAD[name]
    torch.save(content, tmp_path / "a.pt")
    with pytest.raises(StyleSplatError) as error:
        read_splats(tmp_path / "a.pt")
    assert fact in str(error.value) and str(tmp_path / "a.pt") in str(error.value)
