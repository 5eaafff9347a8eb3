"""One object to repaint, and what all objects share."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.style_config import Precision, StyleConfig


@dataclass(frozen=True)
class StyleJob:
    """One object and the style it is to have."""

    name: str
    """What messages and metrics call it."""
    picked: Bool[Tensor, " N"]
    """Its Gaussians."""
    styles: tuple[Float[Tensor, "_ _ 3"], ...]
    """The style images, colours in 0..1; every feature takes the best match of all."""
    config: StyleConfig
    """Its settings."""


@dataclass(frozen=True)
class Studio:
    """What all jobs share."""

    splats: Splats
    """The scene before."""
    cameras: Cameras
    """Views to optimise on."""
    every_camera: Cameras
    """Those and the held-out ones, in which nothing but the object may change."""
    network: FeatureNetwork
    """Whose features are matched, in float32."""
    precision: torch.dtype
    """Of the features while optimising."""
    max_memory: float
    """Bytes that linear views may take."""

    @property
    def precision_name(self) -> Precision:
        """As recipes have it."""
        return "bfloat16" if self.precision == torch.bfloat16 else "float32"
