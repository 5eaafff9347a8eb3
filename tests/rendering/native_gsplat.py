"""Stand-ins for what gsplat 1.5.3 has compiled, in plain torch, for machines without a GPU.

gsplat's own Python runs unchanged above them, so it is gsplat that checks the names, number,
shapes and channels of what it is called with. The mathematics is our reference's.
"""

from dataclasses import dataclass, field

import pytest
import torch
from torch import Tensor

from stylesplat.rendering import reference
from stylesplat.rendering.reference import EPS2D, FAR_PLANE, NEAR_PLANE, Gaussians, View
from stylesplat.scene.splats import sh_basis

SUPPORTED = {1, 2, 3, 4, 5, 8, 9, 16, 17, 32, 33, 64, 65, 128, 129, 256, 257, 512, 513}


@dataclass
class Calls:
    """What was asked of the stand-ins."""

    projections: int = 0
    sorts: int = 0
    blended_channels: list[int] = field(default_factory=list)


def install(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Put the stand-ins into gsplat for one test."""
    native = pytest.importorskip("gsplat.cuda._wrapper")
    project, calls = reference.Rasterizer().project_gaussians, Calls()

    class Projection:
        @staticmethod
        def apply(means, covars, quats, scales, viewmats, Ks, width, height, *options):
            *cuts, compensate, camera_model, opacities = options
            assert covars is None and camera_model == "pinhole"
            assert cuts == [EPS2D, NEAR_PLANE, FAR_PLANE, 0.0]
            assert len(means), "gsplat divides whole numbers by that of Gaussians: the process dies"
            calls.projections += 1
            gaussians = Gaussians(means, quats, scales, opacities, compensate)
            each = [
                project(gaussians, View(viewmat, K, width, height))
                for viewmat, K in zip(viewmats, Ks, strict=True)
            ]
            means2d, conics, seen_opacities, depths, radii = (
                torch.stack(tensors) for tensors in zip(*each, strict=True)
            )
            hidden = (radii == 0).any(dim=-1)
            means2d, conics, depths = (
                each.masked_fill(hidden[(..., *[None] * (each.ndim - 2))], torch.nan)
                for each in (means2d, conics, depths)
            )  # memory that gsplat does not write
            factors = seen_opacities / opacities.clamp(min=1e-30) if compensate else None
            return radii, means2d, depths, conics, factors

    class Blending:
        @staticmethod
        def apply(means2d, conics, colors, opacities, backgrounds, masks, *rest):
            assert backgrounds is None and masks is None
            assert colors.shape[-1] in SUPPORTED
            calls.blended_channels.append(colors.shape[-1])
            return blend_tiles(means2d, conics, opacities, colors, rest)

    class Harmonics:
        @staticmethod
        def apply(degree, dirs, coeffs, masks):
            dirs, shape = torch.nn.functional.normalize(dirs, dim=-1), dirs.shape[:-1]
            basis = sh_basis(degree, dirs.flatten(0, -2)).unflatten(0, shape)
            colors = torch.einsum("...k,...kc->...c", basis, coeffs[..., : basis.shape[-1], :])
            return colors if masks is None else colors * masks[..., None]

    def compiled(name: str):
        def counted(*args):
            if name == "intersect_tile":
                calls.sorts += 1
            stand_ins = {
                "intersect_tile": intersect_tile,
                "intersect_offset": intersect_offset,
                "rasterize_to_indices_3dgs": list_contributors,
            }
            return stand_ins[name](*args)

        return counted

    monkeypatch.setattr(native, "_FullyFusedProjection", Projection)
    monkeypatch.setattr(native, "_RasterizeToPixels", Blending)
    monkeypatch.setattr(native, "_SphericalHarmonics", Harmonics)
    monkeypatch.setattr(native, "_make_lazy_cuda_func", compiled)
    return calls


def intersect_tile(
    means2d, radii, depths, image_ids, gaussian_ids, images, tile, columns, rows, *_
):
    """Which Gaussians reach which tiles, tile by tile and front to back."""
    assert image_ids is None and gaussian_ids is None
    low, high = ((means2d - radii) / tile).floor(), ((means2d + radii) / tile).ceil()  # [I, N, 2]
    y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    places = torch.stack([x, y], dim=-1).reshape(1, 1, -1, 2)
    reached = ((low[:, :, None] <= places) & (places < high[:, :, None])).all(dim=-1)
    reached &= (radii > 0).all(dim=-1)[:, :, None]
    image, gaussian, place = reached.nonzero().unbind(dim=1)
    nearest = torch.argsort(depths[image, gaussian], stable=True)
    image, gaussian, place = (ids[nearest] for ids in (image, gaussian, place))
    tiles, order = torch.sort(image * rows * columns + place, stable=True)
    assert images == len(means2d)
    return reached.sum(dim=-1), tiles, (image * means2d.shape[1] + gaussian)[order]


def intersect_offset(tiles: Tensor, images: int, columns: int, rows: int) -> Tensor:
    """Where each tile's list begins."""
    every = torch.arange(images * rows * columns)
    return torch.searchsorted(tiles, every).reshape(images, rows, columns)


def list_contributors(first: int, last: int, light, means2d, conics, opacities, *rest):
    """The Gaussians that each pixel of one image shows, front to back, pixel by pixel."""
    assert first == 0 and last > len(rest[-1]) and bool((light == 1).all())
    width, height, tile, offsets, flatten_ids = rest
    _, rows, columns = offsets.shape
    starts = [*offsets.flatten().tolist(), len(flatten_ids)]
    found = []
    for row, column in torch.cartesian_prod(torch.arange(rows), torch.arange(columns)).tolist():
        place = row * columns + column
        ids = flatten_ids[starts[place] : starts[place + 1]]
        ys = torch.arange(tile * row, min(tile * (row + 1), height))
        xs = torch.arange(tile * column, min(tile * (column + 1), width))
        pixels = torch.cartesian_prod(ys, xs)
        centres = pixels.flip(1).to(means2d) + 0.5
        weights = reference._blend_weights(
            centres, means2d[0, ids], conics[0, ids], opacities[0, ids]
        )
        which, ranks = weights.nonzero(as_tuple=True)
        found.append(torch.stack([pixels[which] @ torch.tensor([width, 1]), ids[ranks]]))
    pixels, ids = torch.cat(found, dim=1)
    order = torch.argsort(pixels, stable=True)
    return ids[order], pixels[order]


def blend_tiles(means2d: Tensor, conics: Tensor, opacities: Tensor, colors: Tensor, rest):
    """Image and coverage, by the tile lists alone."""
    width, height, tile, offsets, flatten_ids, absgrad = rest
    assert not absgrad
    images, channels = len(colors), colors.shape[-1]
    means2d, conics = means2d.flatten(0, 1), conics.flatten(0, 1)
    opacities, colors = opacities.flatten(), colors.flatten(0, 1)
    ends = torch.cat([offsets.flatten()[1:], offsets.new_tensor([len(flatten_ids)])])
    made = []
    for (image, row, column), first, last in zip(
        torch.cartesian_prod(*(torch.arange(n) for n in offsets.shape)).tolist(),
        offsets.flatten().tolist(),
        ends.tolist(),
        strict=True,
    ):
        ids = flatten_ids[first:last]
        ys = torch.arange(tile * row, min(tile * (row + 1), height))
        xs = torch.arange(tile * column, min(tile * (column + 1), width))
        pixels = torch.cartesian_prod(ys, xs).flip(1).to(means2d) + 0.5
        weights = reference._blend_weights(pixels, means2d[ids], conics[ids], opacities[ids])
        values = torch.cat([weights @ colors[ids], weights.sum(dim=1, keepdim=True)], dim=1)
        made.append((image, ys, xs, values.reshape(len(ys), len(xs), -1)))
    canvas = colors.new_zeros(images, height, width, channels + 1)
    for image, ys, xs, values in made:
        index = (torch.tensor(image), ys[:, None], xs[None])
        canvas = canvas.index_put(index, values)
    return canvas[..., :-1], canvas[..., -1:]
