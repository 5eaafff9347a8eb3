"""Splats in the formats of other programs."""

from pathlib import Path

import gsply
import numpy as np
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path
from stylesplat.io.splat_ply import write_splat_ply
from stylesplat.rendering.sh import SH_C0
from stylesplat.scene.splats import Splats

SPZ_POSITION = 2**23 - 1  # largest fixed-point coordinate
SPZ_FRACTION = range(1, 21)  # bits behind the point; 20 resolve a millionth
SPZ_FLIP = torch.tensor([1.0, -1.0, -1.0])  # PLY's x right, y down to SPZ's x right, y up
SPZ_FLIP_SH = torch.tensor([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])  # per band
SPLAT_ROW = np.dtype(
    [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)]
)


def export(splats: Splats, path: Path | str, *, overwrite: bool = True) -> None:
    """Write splats for a viewer, in the format that the file's suffix names.

    `.ply` keeps every bit. `.spz` is about ten times smaller: positions, colours and rotations
    are rounded. `.splat` has one colour per Gaussian, seen the same from everywhere.

    Args:
        splats: What to write.
        path: A file name ending in `.ply`, `.spz` or `.splat`.
        overwrite: Whether a file of that name may be replaced.

    Raises:
        StyleSplatError: If the suffix is none of these, the file exists and may not be replaced,
            it cannot be written, or the splats reach farther than `.spz` can express.
    """
    path = Path(path)
    writers = {".ply": write_splat_ply, ".spz": _write_spz, ".splat": _write_splat}
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise StyleSplatError(
            f"Cannot export to {path}: unknown suffix {path.suffix!r}. Use {', '.join(writers)}."
        )
    if path.exists() and not overwrite:
        raise StyleSplatError(f"{path} exists already. Replace it with `--overwrite`.")
    writer(splats.detach().to("cpu"), path)


def _write_spz(splats: Splats, path: Path) -> None:
    reach = float(splats.means.abs().max()) if len(splats) else 0.0
    bits = [b for b in SPZ_FRACTION if reach * 2**b <= SPZ_POSITION]
    if not bits:
        raise StyleSplatError(
            f"Cannot export to {path}: the splats reach {reach:.0f} units from the origin, which "
            "SPZ cannot express. Export a .ply."
        )
    data = gsply.GSData(
        means=(splats.means * SPZ_FLIP).numpy(),
        scales=splats.scales.numpy(),
        quats=torch.cat([splats.quats[:, :2], -splats.quats[:, 2:]], dim=1).numpy(),
        opacities=splats.opacities.numpy(),
        sh0=splats.sh0[:, 0].numpy(),
        shN=(splats.shN * SPZ_FLIP_SH[: splats.shN.shape[1], None]).numpy(),
    )
    with atomic_path(path) as temporary:
        gsply.write_spz(temporary, data, fractional_bits=max(bits))


def _write_splat(splats: Splats, path: Path) -> None:
    """The 32-byte rows of antimatter15/splat, the largest and most opaque Gaussians first."""
    alphas = torch.sigmoid(splats.opacities)
    order = torch.argsort(splats.scales.sum(dim=1).exp() * alphas, descending=True, stable=True)
    colors = 0.5 + SH_C0 * splats.sh0[:, 0]
    rows = np.empty(len(splats), SPLAT_ROW)
    rows["mean"] = splats.means[order].numpy()
    rows["scale"] = splats.scales[order].exp().numpy()
    rows["rgba"] = _bytes(255 * torch.cat([colors, alphas[:, None]], dim=1))[order]
    quats = torch.nn.functional.normalize(splats.quats, dim=1)
    rows["quat"] = _bytes(128 + 128 * quats)[order]
    with atomic_path(path) as temporary:
        temporary.write_bytes(rows.tobytes())


def _bytes(values: torch.Tensor) -> np.ndarray:
    return values.round().clamp(0, 255).to(torch.uint8).numpy()
