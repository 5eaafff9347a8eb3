"""The one way to an image: pick a device, activate the splats, render with its backend.

`rasterize` is differentiable and takes several cameras; `render` takes one, without gradients, in
the memory of what is in view.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

from collections.abc import Iterator
from functools import cache
from warnings import catch_warnings, simplefilter

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from stylesplat.errors import StyleSplatError
from stylesplat.interrupts import raise_if_interrupted
from stylesplat.progress import say
from stylesplat.rendering.nvrtc import driver_state
from stylesplat.rendering.reference import (
    Backend,
    Projections,
    activated,
    rasterizer,
    stacked,
    with_matrices_of,
)
from stylesplat.rendering.visibility import PART, VISIBLE_MANY, bounds, in_view, visible
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats


def pick_device(name: torch.device | str = "auto") -> torch.device:
    """The device called `auto`, `cpu`, `cuda` or `cuda:1`; `auto` is an NVIDIA GPU if there is one.

    Raises:
        StyleSplatError: If it is none of these, or `cuda` is asked for and torch sees no GPU.
    """
    if name == "auto":
        if has_nvidia_gpu():
            return torch.device("cuda")
        _say_why_gpu_is_unused()
        return torch.device("cpu")
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError):  # torch's own words for what is no device
        device = None
    if device is None or device.type not in ("cpu", "cuda"):
        raise StyleSplatError(f"There is no device {str(name)!r}. Use auto, cpu or cuda.")
    if device.type == "cuda" and not has_nvidia_gpu():
        why = why_gpu_is_unused() or "torch sees no NVIDIA GPU here"
        raise StyleSplatError(f"Cannot compute on cuda: {why}. Or use --device cpu.")
    return device


def has_nvidia_gpu() -> bool:
    """Whether torch sees one; builds of torch for AMD's GPUs call these `cuda`, too."""
    with catch_warnings():
        simplefilter("ignore")  # `why_gpu_is_unused` says in a line what torch warns of
        return torch.cuda.is_available() and torch.version.hip is None


def why_gpu_is_unused() -> str | None:
    """Why a GPU of this machine is not used, and what helps; None if there is none."""
    maker = "AMD" if torch.version.hip else "Apple" if torch.backends.mps.is_available() else None
    if maker:
        return f"kernels are for NVIDIA's GPUs, not for {maker}'s"
    driver, built_for = driver_state(), torch.version.cuda
    if driver is None or driver.gpus == 0:
        return None
    if built_for is None:
        return (
            f"there is an NVIDIA GPU, and torch {torch.__version__} is built without CUDA. "
            "Install a CUDA build of torch, see https://pytorch.org/get-started/locally/"
        )
    newest = ".".join(map(str, driver.cuda))
    if driver.cuda[0] < int(built_for.split(".")[0]):
        return (
            f"NVIDIA's driver is too old: it supports CUDA {newest}, and torch "
            f"{torch.__version__} needs {built_for}. Update the driver"
        )
    return (
        f"NVIDIA's driver finds a GPU, and torch {torch.__version__} does not. Restart the "
        "machine, as after an update of the driver"
    )


@cache
def _say_why_gpu_is_unused() -> None:
    if why := why_gpu_is_unused():
        say(f"Computing on the CPU: {why}.")


def rasterize(
    splats: Splats,
    cameras: Cameras,
    *,
    features: Float[Tensor, "N F"] | None = None,
    features_move_geometry: bool = True,
    background: Float[Tensor, " 3"] | None = None,
    sh_degree: int | None = None,
    clamp: bool = True,
    raise_clamped: bool = False,
    backend: Backend = "auto",
) -> tuple[Float[Tensor, "C H W D"], Float[Tensor, "C H W 1"], Projections]:
    """Render splats from cameras of one size, differentiably.

    Gradients reach the cameras' `viewmats`, too, if these require them.

    Args:
        splats: The Gaussians, as stored; they are activated here.
        cameras: One or more cameras that share an image size.
        features: More channels to composite in the same pass, such as the identities; they
            follow the three colours.
        features_move_geometry: Whether gradients of these channels reach more than `features`.
        background: RGB behind everything; black by default. Features have 0 behind them.
        sh_degree: Degree of colour to use; that of the splats by default.
        clamp: Whether Gaussians' colours below 0 become 0, as gsplat has it.
        raise_clamped: Whether a clamped colour has the gradients that would raise it, for training:
            without any, what starts black stays black.
        backend: `auto` takes `cuda`, our kernels, for tensors on a GPU and `cpu` for the others.

    Returns:
        The image, linear in the features and not clamped above 1; the coverage; and gsplat's
        `means2d` [C,N,2], `conics` [C,N,3], `opacities` [C,N] (as rendered: smaller for small
        Gaussians of antialiased splats), `depths` [C,N] and `radii` [C,N,2] (0 = out of view).

    Raises:
        StyleSplatError: If the cameras differ in size; if the backend is `gsplat` and it is not
            installed; or if a GPU's kernels cannot be compiled or started.
    """
    raise_if_interrupted()
    drawn_by = rasterizer(backend, splats.device)
    cameras = with_matrices_of(splats, cameras)
    degree = splats.sh_degree if sh_degree is None else min(sh_degree, splats.sh_degree)
    clamp = clamp and not raise_clamped  # which clamps below
    views = []
    for origin in cameras.positions:
        dirs = splats.means - origin
        views.append(
            drawn_by.spherical_harmonics(degree, dirs, splats.sh0, splats.shN, clamp=clamp)
        )
    colors = stacked(tuple(views))  # [C, N, 3]
    if raise_clamped:
        colors = _ColorClamp.apply(colors)
    if features is not None:
        colors = torch.cat([colors, features.expand(len(cameras), -1, -1)], dim=-1)
    render_colors, render_alphas, info = drawn_by.rasterize(
        activated(splats),
        colors,
        cameras,
        geometry_channels=colors.shape[-1] if features_move_geometry else 3,
    )
    return over_background(render_colors, render_alphas, background), render_alphas, info


class _ColorClamp(Function):
    """Clamps at 0; of a clamped colour only gradients that raise it, in descent, pass."""

    @staticmethod
    def forward(ctx, colors):
        ctx.save_for_backward(colors > 0)
        return colors.clamp(min=0)

    @staticmethod
    @once_differentiable
    def backward(ctx, v_colors):
        (is_inside,) = ctx.saved_tensors
        return v_colors.where(is_inside | (v_colors < 0), 0)


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


@torch.no_grad()
def render(
    splats: Splats,
    camera: Cameras,
    *,
    features: Float[Tensor, "N F"] | None = None,
    background: Float[Tensor, " 3"] | None = None,
    sh_degree: int | None = None,
    pixels: Bool[Tensor, "H W"] | None = None,
) -> tuple[Float[Tensor, "H W D"], Float[Tensor, "H W 1"]]:
    """Render splats from one camera, without gradients.

    Args:
        splats: The Gaussians.
        camera: One camera.
        features: More channels to composite in the same pass; they follow the three colours.
        background: RGB behind everything; black by default. Features have 0 behind them.
        sh_degree: Degree of colour to use; that of the splats by default.
        pixels: The pixels wanted; others need not be right. All by default.

    Returns:
        The image and the coverage, as `rasterize` has them.
    """
    rest = {"features": features, "background": background, "sh_degree": sh_degree}
    if splats.device.type != "cpu":
        images, alphas, _ = rasterize(splats, camera, **rest)
        return images[0], alphas[0]
    from stylesplat.rendering import cpu

    near = in_view(splats, camera, pixels)
    if features is not None and len(near.rows) > VISIBLE_MANY:
        near = visible(near, camera)
    colors = colors_of(
        splats, near.rows, with_matrices_of(splats, camera).positions, sh_degree, features
    )
    raster = cpu.rasterize_to_pixels(near.projected, cpu.padded(colors), camera.size)
    image, alphas = raster.image[..., : colors.shape[1]], raster.alphas
    return over_background(image, alphas, background), alphas


@torch.no_grad()
def render_row_bands(
    splats: Splats, camera: Cameras, *, background: Float[Tensor, " 3"], height: int
) -> Iterator[tuple[int, Float[Tensor, "h W 3"]]]:
    """Render splats from one camera in bands of rows, the middle ones first.

    Args:
        splats: The Gaussians.
        camera: One camera.
        background: RGB behind everything.
        height: Rows of a band, but for the lowest; a GPU renders all at once.

    Yields:
        The first row of a band, and its image.
    """
    if splats.device.type != "cpu":
        yield 0, render(splats, camera, background=background)[0]
        return
    from stylesplat.rendering import cpu

    near = in_view(splats, camera)
    colors = colors_of(splats, near.rows, with_matrices_of(splats, camera).positions)
    (low, high), (width, total) = bounds(near.projected), camera.size
    tops = range(0, total, height)
    for top in sorted(tops, key=lambda top: abs(2 * top + height - total)):
        end = min(top + height, total)
        places = ((low[:, 1] < end) & (high[:, 1] > top)).nonzero()[:, 0]
        projected = near.some(places).projected
        shifted = projected.means2d - projected.means2d.new_tensor([0, top])
        part = projected._replace(means2d=shifted)
        raster = cpu.rasterize_to_pixels(part, colors[places], (width, end - top))
        yield top, over_background(raster.image, raster.alphas, background)


def colors_of(
    splats: Splats,
    rows: Int[Tensor, " M"],
    origin: Float[Tensor, "1 3"],
    sh_degree: int | None = None,
    features: Float[Tensor, "N F"] | None = None,
) -> Float[Tensor, "M D"]:
    """Colours of some Gaussians as seen from a point; their features follow."""
    drawn_by = rasterizer("auto", splats.device)
    degree = splats.sh_degree if sh_degree is None else min(sh_degree, splats.sh_degree)
    tensors = splats.means, splats.sh0, splats.shN[:, : (degree + 1) ** 2 - 1]
    parts = []
    for some in rows.split(PART):
        means, *sh = (each.index_select(0, some) for each in tensors)
        own = drawn_by.spherical_harmonics(degree, means - origin, *sh)
        if features is not None:
            own = torch.cat([own, features.index_select(0, some)], dim=1)
        parts.append(own)
    return parts[0] if len(parts) == 1 else torch.cat(parts)
