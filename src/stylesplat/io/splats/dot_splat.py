"""Splats as .splat, rows of 32 bytes as in antimatter15/splat: one colour per Gaussian."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped, UInt8
from torch import Tensor

from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes
from stylesplat.io.splats.packing import SMALLEST, unit_quats
from stylesplat.scene.splats import Splats, rgb_from_sh0, sh0_from_rgb

ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
HALF_STEP = 0.5 / 255  # an opacity of 0 or 1 has no logit


def read_dot_splat(path: Path | str) -> Splats:
    content = read_bytes(path)
    if len(content) % ROW.itemsize:
        fault = f"its {len(content)} bytes are no whole number of rows of {ROW.itemsize}"
        raise ValueError(f"{fault}: it is cut off, or no .splat")
    rows = np.frombuffer(content, ROW)
    sh0, opacities = from_rgba(rows["rgba"])
    codes = to_floats(rows["quat"])
    quats = ((codes - 128) / 128).where(codes.any(dim=1, keepdim=True), 0.0)  # of rows of zeros
    return Splats(
        means=to_floats(rows["mean"]),
        quats=quats,
        scales=to_floats(rows["scale"]).abs().log(),  # viewers square them
        opacities=opacities,
        sh0=sh0,
        shN=torch.zeros(len(rows), 0, 3),
    )


def from_rgba(
    pixels: UInt8[np.ndarray, "N 4"],
) -> tuple[Float[Tensor, "N 1 3"], Float[Tensor, " N"]]:
    """The constant band of colour, and the logits of opacities."""
    rgba = to_floats(pixels) / 255
    return sh0_from_rgb(rgba[:, None, :3]), rgba[:, 3].clamp(HALF_STEP, 1 - HALF_STEP).logit()


def write_dot_splat(splats: Splats, path: Path | str) -> None:
    """Write a .splat file, the largest and most opaque Gaussians first."""
    alphas, order = torch.sigmoid(splats.opacities), dot_splat_order(splats)
    colors = rgb_from_sh0(splats.sh0[:, 0])
    rows = np.empty(len(splats), ROW)
    rows["mean"] = splats.means[order].numpy()
    rows["scale"] = splats.scales[order].exp().clamp(min=SMALLEST).numpy()
    rows["rgba"] = _bytes(255 * torch.cat([colors, alphas[:, None]], dim=1))[order]
    rows["quat"] = _bytes(128 + 128 * unit_quats(splats.quats))[order]
    with atomic_path(path) as draft:
        draft.write_bytes(rows.tobytes())


def dot_splat_order(splats: Splats) -> Int[Tensor, " N"]:
    """The Gaussian of each row: the largest and most opaque first."""
    sizes = splats.scales.sum(dim=1).exp() * torch.sigmoid(splats.opacities)
    return torch.argsort(sizes, descending=True, stable=True)


def _bytes(values: torch.Tensor) -> np.ndarray:
    return values.round().clamp(0, 255).to(torch.uint8).numpy()


def to_floats(values: Shaped[np.ndarray, "*B"]) -> Float[Tensor, "*B"]:
    return torch.from_numpy(np.array(values, np.float32))
