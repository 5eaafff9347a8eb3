"""The one way to an image: activate the splats, pick a backend, render."""

from dataclasses import replace
from importlib.util import find_spec
from typing import Literal, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.rendering.gaussians import Gaussians
from stylesplat.rendering.reference import Info
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

Backend = Literal["auto", "reference", "cpu", "cuda"]
EVERYONE = slice(None)


@runtime_checkable
class Rasterizer(Protocol):
    """What a backend is: a module with two functions."""

    def spherical_harmonics(
        self,
        degree: int,
        dirs: Float[Tensor, "N 3"],
        sh0: Float[Tensor, "N 1 3"],
        shN: Float[Tensor, "N _ 3"],
        *,
        clamp: bool = True,
    ) -> Float[Tensor, "N 3"]:
        """Colours of Gaussians seen along `dirs`; see `sh.sh_colors`."""
        ...

    def rasterize(
        self,
        gaussians: Gaussians,
        colors: Float[Tensor, "C N D"],
        cameras: Cameras,
        *,
        geometry_channels: int,
    ) -> tuple[Float[Tensor, "C H W D"], Float[Tensor, "C H W 1"], Info]:
        """Image, coverage and projections of Gaussians, each camera with colours of its own.

        Gradients of the channels from `geometry_channels` on reach `colors` only. The cameras'
        matrices have the Gaussians' type and device.
        """
        ...


def activated(splats: Splats, part: slice = EVERYONE) -> Gaussians:
    """What is drawn of splats, or of a part of them."""
    scales, opacities = splats.scales[part].exp(), torch.sigmoid(splats.opacities[part])
    return Gaussians(splats.means[part], splats.quats[part], scales, opacities)


def beside(splats: Splats, cameras: Cameras) -> Cameras:
    """The cameras with matrices of the splats' type and device."""
    viewmats, Ks = cameras.viewmats.to(splats.means), cameras.Ks.to(splats.means)
    return replace(cameras, viewmats=viewmats, Ks=Ks)


def rasterize(
    splats: Splats,
    cameras: Cameras,
    *,
    features: Float[Tensor, "N F"] | None = None,
    features_move_geometry: bool = True,
    background: Float[Tensor, " 3"] | None = None,
    sh_degree: int | None = None,
    clamp: bool = True,
    backend: Backend = "auto",
) -> tuple[Float[Tensor, "C H W D"], Float[Tensor, "C H W 1"], Info]:
    """Render splats from cameras of one size, differentiably.

    Gradients reach the cameras' `viewmats`, too, if these require them.

    Args:
        splats: The Gaussians, as stored; they are activated here.
        cameras: One or more cameras that share an image size.
        features: More channels to composite in the same pass, such as the identities; they
            follow the three colours.
        features_move_geometry: Whether gradients of these channels reach more than `features`.
        background: RGB behind everything; black by default. Features have 0 behind them.
        sh_degree: How many bands of colour to use; all of them by default.
        clamp: Whether Gaussians' colours below 0 become 0, as gsplat has it.
        backend: `auto` takes `cuda` for tensors on a GPU and `cpu` for the others.

    Returns:
        The image, linear in the features and not clamped above 1; the coverage; and gsplat's
        `means2d` [C,N,2], `conics` [C,N,3], `depths` [C,N] and `radii` [C,N,2] (0 = not seen).

    Raises:
        StyleSplatError: If the cameras differ in size or gsplat is not installed.
    """
    backend_module = _module(backend, splats.device)
    cameras = beside(splats, cameras)
    degree = splats.sh_degree if sh_degree is None else min(sh_degree, splats.sh_degree)
    colors = torch.stack(
        [
            backend_module.spherical_harmonics(
                degree, splats.means - origin, splats.sh0, splats.shN, clamp=clamp
            )
            for origin in cameras.positions
        ]
    )  # [C, N, 3]
    if features is not None:
        colors = torch.cat([colors, features.expand(len(cameras), -1, -1)], dim=-1)
    render_colors, render_alphas, info = backend_module.rasterize(
        activated(splats),
        colors,
        cameras,
        geometry_channels=colors.shape[-1] if features_move_geometry else 3,
    )
    return over_background(render_colors, render_alphas, background), render_alphas, info


def over_background(
    colors: Float[Tensor, "*B H W D"],
    alphas: Float[Tensor, "*B H W 1"],
    background: Float[Tensor, " 3"] | None,
) -> Float[Tensor, "*B H W D"]:
    """Images before a colour, or before black; features have 0 behind them."""
    if background is None:
        return colors
    padding = background.new_zeros(colors.shape[-1] - 3)
    return colors + (1 - alphas) * torch.cat([background, padding]).to(colors)


def _module(backend: Backend, device: torch.device) -> Rasterizer:
    if backend == "auto":
        backend = "cuda" if device.type == "cuda" else "cpu"
    if backend == "reference":
        from stylesplat.rendering import reference

        return reference
    if backend == "cpu":
        from stylesplat.rendering import cpu

        return cpu
    if find_spec("gsplat") is None:
        raise StyleSplatError(
            "Rendering on a GPU needs gsplat, which is not installed. "
            "Run `pip install stylesplat[cuda]`, or choose the cpu device."
        )
    from stylesplat.rendering import cuda

    return cuda
