"""The rasteriser's specification, and what every backend shares: nouns, and constants.

Semantics are those of gsplat 1.5.3 (`rasterization`, in its classic mode and, for antialiased
Gaussians, its antialiased one). The CPU kernels take the nouns with arrays in the place of tensors.
"""

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import pixel_centres
from stylesplat.scene.splats import Splats, sh_basis

Backend = Literal["auto", "reference", "cpu", "cuda", "gsplat"]
ON_GPU = "cuda"  # what `auto` takes for tensors on a GPU: `cuda`, our kernels, or `gsplat`
RASTERIZERS = {  # their modules and names
    "reference": ("reference", "Rasterizer"),
    "cpu": ("cpu", "CpuRasterizer"),
    "cuda": ("cuda", "CudaRasterizer"),
    "gsplat": ("through_gsplat", "GsplatRasterizer"),
}
Projections = dict[str, Tensor]
"""What `Projected` has, of each camera."""

EVERYONE = slice(None)

# The numbers that define what a rendered image is. All are gsplat 1.5.3's.
EPS2D = 0.3  # variance in square pixels added to every projected Gaussian: a low-pass filter
NEAR_PLANE = 0.01  # Gaussians nearer than this are not drawn
FAR_PLANE = 1e10  # nor those farther
MIN_ALPHA = 1 / 255  # fainter contributions are skipped
MAX_ALPHA = 0.999  # the clamp of version 1.5; the backward pass divides by 1 - alpha
MIN_TRANSMITTANCE = 1e-4  # a pixel is finished before it becomes darker than this
MAX_EXTENT = 3.33  # standard deviations at which a Gaussian of opacity 1 falls below MIN_ALPHA
MAX_RADIUS = 1 << 30  # pixels: radii are int32
FOV_MARGIN = 0.3  # how far outside the image, in half fields of view, the Jacobian is exact
# Logarithm: gsplat takes the fourth power of a standard deviation in pixels, and beyond float32 its
# picture is black
LARGEST_SCALE = 13.8

PIXELS_AT_ONCE = 4096  # bounds the pixels x Gaussians matrix
FLAT = 1e-12  # share of an area, whose root makes all opacities invisible: a root has no slope at 0


class Gaussians(NamedTuple):
    """Activated splats."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    """wxyz, any norm."""
    scales: Float[Tensor, "N 3"]
    """Standard deviations along the axes."""
    opacities: Float[Tensor, " N"]
    """From 0 to 1."""
    antialiased: bool = False
    """Whether projection scales opacities by how much the low-pass filter enlarges a Gaussian."""


class View(NamedTuple):
    viewmat: Float[Tensor, "4 4"]
    K: Float[Tensor, "3 3"]
    width: int
    height: int


class Projected(NamedTuple):
    """Gaussians in the pixels of one camera."""

    means2d: Float[Tensor, "N 2"]
    conics: Float[Tensor, "N 3"]
    """Inverse covariances: xx, xy, yy."""
    opacities: Float[Tensor, " N"]
    """Those of the Gaussians; of antialiased ones as this camera sees them."""
    depths: Float[Tensor, " N"]
    radii: Int[Tensor, "N 2"]
    """Whole pixels in x and y; 0 for Gaussians out of view."""


class ProjectedView(NamedTuple):
    """What is composited. Backends of GPUs have their own, with Gaussians sorted into tiles."""

    projected: Projected
    size: tuple[int, int]


def views_of(cameras: Cameras) -> list[View]:
    """The cameras one by one; they share an image size."""
    matrices = zip(cameras.viewmats, cameras.Ks, strict=True)
    return [View(viewmat, K, *cameras.size) for viewmat, K in matrices]


def activated(splats: Splats, part: slice = EVERYONE) -> Gaussians:
    """The Gaussians of splats, or of a part of them, as renderers take them."""
    scales = splats.scales[part].clamp(max=LARGEST_SCALE).exp()
    opacities = torch.sigmoid(splats.opacities[part])
    places = splats.means[part], splats.quats[part]
    return Gaussians(*places, scales, opacities, splats.antialiased)


def with_matrices_of(splats: Splats, cameras: Cameras) -> Cameras:
    """The cameras with matrices of the splats' type and device.

    A GPU gets them from pinned memory, for which the host does not wait.
    """
    matrices = cameras.viewmats, cameras.Ks
    if splats.means.is_cuda and not any(each.is_cuda or each.requires_grad for each in matrices):
        matrices = (each.pin_memory() for each in matrices)
    viewmats, Ks = (each.to(splats.means, non_blocking=splats.means.is_cuda) for each in matrices)
    return replace(cameras, viewmats=viewmats, Ks=Ks)


def rasterizer(backend: Backend, device: torch.device) -> "Rasterizer":
    """The rasteriser of a backend; its kernels are loaded when they are needed."""
    if backend == "auto":
        backend = ON_GPU if device.type == "cuda" else "cpu"
    if backend == "gsplat" and find_spec("gsplat") is None:
        raise StyleSplatError(
            "The backend gsplat is not installed. Run `pip install 'stylesplat[gsplat]'`, or take "
            "the backend cuda."
        )
    name, of_class = RASTERIZERS[backend]
    module = import_module(f"stylesplat.rendering.{name}")
    if backend == "gsplat" and device.type == "cuda":
        module.require_kernels()
    return getattr(module, of_class)()


def rotation_matrices(quats: Float[Tensor, "N 4"]) -> Float[Tensor, "N 3 3"]:
    """Rotation matrices of wxyz quaternions of any norm."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def perspective_jacobian(means_c: Float[Tensor, "N 3"], view: View) -> Float[Tensor, "N 2 3"]:
    """Derivative of pixel by camera position, held constant far outside the image."""
    _, K, width, height = view
    x, y, z = means_c.unbind(-1)
    zero = torch.zeros_like(z)

    def clamped(t: Tensor, focal: Tensor, centre: Tensor, size: int) -> Tensor:
        margin = FOV_MARGIN * 0.5 * size / focal
        low, high = -(centre / focal + margin), (size - centre) / focal + margin
        return z * torch.minimum(torch.maximum(t / z, low), high)

    x = clamped(x, K[0, 0], K[0, 2], width)
    y = clamped(y, K[1, 1], K[1, 2], height)
    row_x = torch.stack([K[0, 0] / z, zero, -K[0, 0] * x / z**2], dim=-1)
    row_y = torch.stack([zero, K[1, 1] / z, -K[1, 1] * y / z**2], dim=-1)
    return torch.stack([row_x, row_y], dim=-2)


@torch.no_grad()
def _radii(variances: Float[Tensor, "N 2"], opacities: Float[Tensor, " N"]) -> Tensor:
    fade = 2 * torch.log(opacities.clamp(min=MIN_ALPHA) / MIN_ALPHA)
    extent = fade.sqrt().clamp(max=MAX_EXTENT)[:, None]
    return (extent * variances.sqrt()).ceil().clamp(max=MAX_RADIUS)


def adjoint(
    composite: Callable[[Any, Tensor], Tensor],
    tiled: Any,
    count: int,
    image: Float[Tensor, "H W D"],
) -> Float[Tensor, "N D"]:
    """The adjoint of a backend's `composite` of so many Gaussians, as its gradient."""
    values = image.new_zeros(count, image.shape[-1]).requires_grad_()
    with torch.enable_grad():
        shown = composite(tiled, values)
        total = shown.flatten() @ image.flatten()  # with grad_outputs torch imports sympy: 1 s
    return torch.autograd.grad(total, values)[0]


def depth_planes(
    gaussians: Gaussians, view: View, conics: Float[Tensor, "N 3"]
) -> Float[Tensor, "N 3"]:
    """The depth of each Gaussian in one camera's pixels: at its centre, its slopes in x and y.

    The mean along the ray through a pixel, which of a flat Gaussian lies in its plane (Zhang et
    al.: RaDe-GS, 2024). The slopes are per pixel.
    """
    rotation = view.viewmat[:3, :3]
    means_c = gaussians.means @ rotation.T + view.viewmat[:3, 3]
    axes = rotation @ (rotation_matrices(gaussians.quats) * gaussians.scales[:, None, :])
    along = (perspective_jacobian(means_c, view) @ axes) @ axes[:, 2, :, None]  # [N, 2, 1]
    a, b, c = conics.unbind(-1)
    slopes = torch.stack([a, b, b, c], dim=-1).view(-1, 2, 2) @ along
    return torch.cat([means_c[:, 2:], slopes[..., 0]], dim=-1)


def depths_at(
    projected: Projected,
    planes: Float[Tensor, "N 3"],
    rows: Int[Tensor, " L"],
    centres: Float[Tensor, "L 2"],
) -> Float[Tensor, " L"]:
    """The depths of some Gaussians, each at a pixel of its own."""
    offsets = centres - projected.means2d[rows]
    return planes[rows, 0] + (offsets * planes[rows, 1:]).sum(dim=1)


def mean_depths(
    pixels: Int[Tensor, " L"],
    weights: Float[Tensor, " L"],
    depths: Float[Tensor, " L"],
    count: int,
    shares: tuple[float, float],
) -> Float[Tensor, "P 2"]:
    """Of so many pixels the mean depth between two shares of their weight, and the weight.

    What each pixel shows follows one another, front to back; no weight is 0.
    """
    exact = weights.double()  # sums over all pixels
    covered = exact.new_zeros(count).index_add(0, pixels, exact)
    reached = exact.cumsum(dim=0) - (covered.cumsum(dim=0) - covered)[pixels]
    low, high = (share * covered for share in shares)
    inside = torch.minimum(reached, high[pixels]) - torch.maximum(reached - exact, low[pixels])
    sums = torch.zeros_like(covered).index_add(0, pixels, inside.clamp(min=0) * depths)
    means = sums / (high - low).where(covered > 0, 1)
    return torch.stack([means, covered], dim=1).to(depths)


def stacked(tensors: tuple[Tensor, ...]) -> Tensor:
    """The tensors of some views as one; of one view without a copy."""
    return tensors[0][None] if len(tensors) == 1 else torch.stack(tensors)


def unstacked(tensor: Tensor) -> tuple[Tensor, ...]:
    """The tensors of each view."""
    return (tensor.squeeze(0),) if len(tensor) == 1 else tensor.unbind()


def _front_to_back(projected: Projected) -> Int[Tensor, " M"]:
    """The Gaussians in view, nearest first."""
    visible = (projected.radii > 0).all(dim=-1).nonzero()[:, 0]
    return visible[torch.argsort(projected.depths[visible], stable=True)]


def _blend_weights(pixels: Tensor, means2d: Tensor, conics: Tensor, opacities: Tensor) -> Tensor:
    alphas = alphas_at(pixels[:, None] - means2d[None], conics, opacities)  # [P, M]
    live = torch.cumprod(1 - alphas, dim=1) > MIN_TRANSMITTANCE
    alphas = torch.where(live, alphas, 0)
    after = torch.cumprod(1 - alphas, dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    return alphas * before


def alphas_at(
    offsets: Float[Tensor, "*B 2"],
    conics: Float[Tensor, "*#B 3"],
    opacities: Float[Tensor, "*#B"],
    most: float = MAX_ALPHA,
) -> Float[Tensor, "*B"]:
    """What Gaussians hide at pixels so far from their centres; 0 if they are too faint there."""
    dx, dy = offsets.unbind(-1)
    a, b, c = conics.unbind(-1)
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alphas = (opacities * torch.exp(-sigma)).clamp(max=most)
    return torch.where((sigma >= 0) & (alphas >= MIN_ALPHA), alphas, 0)


class Rasterizer:
    """The specification, in plain torch: any dtype, gradients by autograd, slow by design.

    Every other backend does the same faster, and is tested against it. They need not follow
    gradients to depths, nor the gradients of what `project_gaussians` gets on its own.
    """

    def spherical_harmonics(
        self,
        degree: int,
        dirs: Float[Tensor, "N 3"],
        sh0: Float[Tensor, "N 1 3"],
        shN: Float[Tensor, "N _ 3"],
        *,
        clamp: bool = True,
    ) -> Float[Tensor, "N 3"]:
        """Colours of Gaussians visible along `dirs`.

        Args:
            degree: How many bands to use; `shN` may hold more.
            dirs: From the camera to the Gaussians, any norm.
            sh0: Constant band.
            shN: Higher bands.
            clamp: Whether colours below 0 become 0, as gsplat has it.
        """
        basis = sh_basis(degree, torch.nn.functional.normalize(dirs, dim=-1))
        sh = torch.cat([sh0, shN], dim=1)[:, : basis.shape[1]]
        colors = torch.einsum("nk,nkc->nc", basis, sh)
        return (colors + 0.5).clamp(min=0) if clamp else colors + 0.5

    def project_gaussians(self, gaussians: Gaussians, view: View) -> Projected:
        """Elliptical weighted average projection of one camera's Gaussians."""
        means, quats, scales, opacities, antialiased = gaussians
        viewmat, K, width, height = view
        rotation = viewmat[:3, :3]
        means_c = means @ rotation.T + viewmat[:3, 3]
        axes = rotation @ (rotation_matrices(quats) * scales[:, None, :])  # [N, 3, 3]
        depths = means_c[:, 2]
        in_range = (depths > NEAR_PLANE) & (depths < FAR_PLANE)
        means_c = torch.where(in_range[:, None], means_c, means_c.new_tensor([0.0, 0.0, 1.0]))
        x_axes, y_axes = (perspective_jacobian(means_c, view) @ axes).unbind(dim=1)  # [N, 3]
        xx, xy, yy = (
            (a * b).sum(-1) for a, b in ((x_axes, x_axes), (x_axes, y_axes), (y_axes, y_axes))
        )
        # The determinant xx yy - xy xy, which cancels for long Gaussians
        sharp = torch.linalg.cross(x_axes, y_axes).square().sum(-1)
        det = sharp + EPS2D * (xx + yy + EPS2D)
        xx, yy = xx + EPS2D, yy + EPS2D
        if antialiased:
            opacities = opacities * (sharp / det).clamp(min=FLAT).sqrt()
        conics = torch.stack([yy, -xy, xx], dim=-1) / det[:, None]
        means2d = torch.stack(
            [
                K[0, 0] * means_c[:, 0] / means_c[:, 2] + K[0, 2],
                K[1, 1] * means_c[:, 1] / means_c[:, 2] + K[1, 2],
            ],
            dim=-1,
        )
        radii = _radii(torch.stack([xx, yy], dim=-1), opacities)
        low, high = means2d - radii, means2d + radii
        size = means2d.new_tensor([width, height])
        on_screen = ((high > 0) & (low < size)).all(dim=-1)
        visible = in_range & on_screen & (opacities >= MIN_ALPHA)
        radii = torch.where(visible[:, None], radii, 0).to(torch.int32)
        return Projected(means2d, conics, opacities, depths, radii)

    def blend(
        self,
        projected: Projected,
        colors: Float[Tensor, "N D"],
        size: tuple[int, int],
        *,
        geometry_channels: int,
    ) -> tuple[Float[Tensor, "H W D"], Float[Tensor, "H W 1"]]:
        """Composite one camera's projected Gaussians front to back; see `rasterize`."""
        width, height = size
        order = _front_to_back(projected)
        means2d, conics, opacities = (each[order] for each in projected[:3])
        parts = []
        for chunk in pixel_centres(width, height).to(means2d).split(PIXELS_AT_ONCE):
            weights = _blend_weights(chunk, means2d, conics, opacities)  # [P, M]
            alphas = weights.sum(dim=1, keepdim=True)
            moving, other = colors[order].tensor_split([geometry_channels], dim=1)
            parts.append(torch.cat([weights @ moving, weights.detach() @ other, alphas], dim=1))
        image = torch.cat(parts).reshape(height, width, -1)
        return image[..., :-1], image[..., -1:]

    def rasterize(
        self,
        gaussians: Gaussians,
        colors: Float[Tensor, "C N D"],
        cameras: Cameras,
        *,
        geometry_channels: int,
    ) -> tuple[Float[Tensor, "C H W D"], Float[Tensor, "C H W 1"], Projections]:
        """Image, coverage and projections of Gaussians, each camera with colours of its own.

        Gradients of the channels from `geometry_channels` on reach `colors` only. The cameras'
        matrices have the Gaussians' type and device.
        """
        projections = [self.project_gaussians(gaussians, view) for view in views_of(cameras)]
        found = Projected(*(stacked(each) for each in zip(*projections, strict=True)))
        # The blended tensors are views of those that return, so gradients reach these, too
        views = zip(*(unstacked(each) for each in found), strict=True)
        blended = [
            self.blend(Projected(*each), own, cameras.size, geometry_channels=geometry_channels)
            for each, own in zip(views, colors, strict=True)
        ]
        images, alphas = (stacked(each) for each in zip(*blended, strict=True))
        return images, alphas, found._asdict()

    def tile(self, projected: Projected, size: tuple[int, int]) -> Any:
        """What `composite` and `backproject` take: one camera's Gaussians, sorted once for all."""
        return ProjectedView(projected, size)

    def composite(self, tiled: Any, values: Float[Tensor, "N D"]) -> Float[Tensor, "H W D"]:
        """Composite values of projected Gaussians; gradients reach the values alone."""
        return self.blend(tiled.projected, values, tiled.size, geometry_channels=0)[0]

    def backproject(self, tiled: Any, image: Float[Tensor, "H W D"]) -> Float[Tensor, "N D"]:
        """The adjoint of `composite`: sums of an image times the weights of each Gaussian."""
        return adjoint(self.composite, tiled, len(tiled.projected.depths), image)

    def front_depth(
        self,
        projected: Projected,
        planes: Float[Tensor, "N 3"],
        counted: Float[Tensor, " N"],
        size: tuple[int, int],
        shares: tuple[float, float],
    ) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
        """The mean depth of a part of each pixel's weight, from one share of it to another.

        Args:
            projected: One camera's Gaussians.
            planes: Their depths, as `depth_planes`.
            counted: How much the weight of each counts; with 0 it only hides what is behind.
            size: Width and height.
            shares: From 0, the front, to 1; of a Gaussian that lies on their border a part counts.

        Returns:
            The depth, 0 where nothing counts, and the sum of what counts.
        """
        (width, height), order = size, _front_to_back(projected)
        means2d, conics, opacities = (each[order] for each in projected[:3])
        centres, found = pixel_centres(width, height).to(means2d), []
        for first in range(0, len(centres), PIXELS_AT_ONCE):
            chunk = centres[first : first + PIXELS_AT_ONCE]
            weights = counted[order] * _blend_weights(chunk, means2d, conics, opacities)  # [P, M]
            pixels, ranks = weights.nonzero(as_tuple=True)
            found.append((pixels + first, order[ranks], weights[pixels, ranks]))
        pixels, rows, weights = (torch.cat(each) for each in zip(*found, strict=True))
        depths = depths_at(projected, planes, rows, centres[pixels])
        image = mean_depths(pixels, weights, depths, len(centres), shares)
        depths, covered = image.reshape(height, width, 2).unbind(dim=2)
        return depths, covered
