"""What gsply reads and writes: splats in PLY's conventions."""

from pathlib import Path

import gsply
import numpy as np
import torch

from stylesplat.io.splats.splat_ply import check_splats
from stylesplat.scene.splats import Splats


def from_gsply(data: gsply.GSData, path: Path | str) -> Splats:
    """Splats of a gsply container in PLY's conventions.

    Raises:
        StyleSplatError: If a number is not finite or a Gaussian has no rotation.
    """
    count = len(data.means)
    higher = np.zeros((count, 0, 3), np.float32) if data.shN is None else data.shN
    return check_splats(
        Splats(
            means=_tensor(data.means),
            quats=_tensor(data.quats),
            scales=_tensor(data.scales),
            opacities=_tensor(data.opacities).reshape(count),
            sh0=_tensor(data.sh0).reshape(count, 1, 3),
            shN=_tensor(higher),
        ),
        path,
    )


def to_gsply(splats: Splats) -> gsply.GSData:
    """Splats as gsply's container, their rotations as they are."""
    return gsply.GSData(
        means=splats.means.numpy(),
        scales=splats.scales.numpy(),
        quats=splats.quats.numpy(),
        opacities=splats.opacities.numpy(),
        sh0=splats.sh0[:, 0].numpy(),
        shN=splats.shN.numpy(),
    )


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
