"""What gsply reads, as splats that were checked."""

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


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
