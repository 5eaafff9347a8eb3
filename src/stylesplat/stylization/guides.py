"""Discs turned along strokes, and lines on an object that the strokes near them follow.

Around each line there is a direction at every place. Where it counts, features are matched with
those of the style picture turned by several angles, by how they look and by how their strokes run.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import affine_transform
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.weights import composite
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.projection import project
from stylesplat.scene.splats import LUMA, Splats
from stylesplat.scene.world_offset import from_world
from stylesplat.selection.shapes import robust_diameter
from stylesplat.stylization.config import StyleConfig, parse_guide
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.matching import StyleIndex, most_similar
from stylesplat.stylization.style import blurred, derivative, fit_style, style_parts

GUIDE_SAMPLES = 200  # places along all lines for each length of the object
GUIDE_NEAREST = 8  # of them, whose directions are averaged
GUIDED_LEAST = 0.1  # weight from which a direction counts
GUIDE_TURNS = 6  # angles of the style picture within half a turn
TURNED_FEATURES = 8192  # at random, of those of all angles
GUIDED = 0.6  # what the full agreement of directions adds to a cosine
FLOW_WIDTH = 0.5  # deviation of the structure tensor's average, in cells of features
STROKE_NEIGHBOURS = 32  # discs that gradients and structure tensors are averaged over
GRADIENT_WIDTH = 1.5  # deviation of the weights of a gradient's fit, in distances between discs
TENSOR_WIDTH = 2.5  # and of the average of structure tensors
STROKE_RIDGE = 1e-3  # of the fit, for discs whose neighbours lie on a line
LONG, NARROW = 1.8, 0.6  # factors on scales along and across a stroke; 2.5 spikes the silhouette


@dataclass(frozen=True, eq=False)
class Guides:
    """The directions around lines."""

    places: Float[Tensor, "S 3"]
    """Along the lines."""
    directions: Float[Tensor, "S 3"]
    """Of length 1, there."""
    reach: float
    """The distance from a line at which it counts for .6 of what it does there."""

    @staticmethod
    def of(config: StyleConfig, splats: Splats, mask: Bool[Tensor, " N"]) -> "Guides | None":
        """Those of an object's settings; None without lines."""
        if not config.guides:
            return None
        extent = robust_diameter(splats.means[mask])
        places, directions = list[Tensor](), list[Tensor]()
        for guide in config.guides:
            line = torch.tensor(parse_guide(guide), dtype=torch.float64).view(-1, 3)
            line = from_world(line, splats.world_offset)
            steps = line[1:] - line[:-1]
            lengths = steps.norm(dim=1)
            for start, step, length in zip(line[:-1], steps, lengths, strict=True):
                count = max(1, math.ceil(GUIDE_SAMPLES * float(length) / extent))
                along = (torch.arange(count, dtype=torch.float64) + 0.5) / count
                places.append(start + along[:, None] * step)
                directions.append((step / length.clamp(min=1e-12)).expand(count, 3))
        every = (torch.cat(each).to(splats.means) for each in (places, directions))
        return Guides(*every, reach=config.guide_reach * extent)

    def tensors(self, means: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3 3"]:
        """The mean of `d d^T` over the directions d near places, times their weight of 0 to 1."""
        far, near = nearest_points(self.places, means, GUIDE_NEAREST)
        weights = (-(far.to(means) / self.reach).square() / 2).exp()
        d = self.directions[near]
        mean = torch.einsum("nk,nki,nkj->nij", weights, d, d)
        total = weights.sum(dim=1).clamp(min=1e-12)
        return mean * (weights.amax(dim=1) / total)[:, None, None]

    def flow(
        self, splats: Splats, camera: Cameras, tensors: Float[Tensor, "N 3 3"]
    ) -> Float[Tensor, "H W 2"]:
        """The directions that one camera sees, as cosine and sine of twice the angle in pixels.

        They are as long as they count.
        """
        wanted = tensors.diagonal(dim1=1, dim2=2).sum(dim=1)
        rows = (wanted > GUIDED_LEAST / 10).nonzero()[:, 0]
        means, turn = splats.means[rows], camera.viewmats[0, :3, :3].to(splats.means)
        pixels, depths = project(means, camera)
        focal = camera.Ks[0].diagonal()[:2].to(means)
        centre = camera.Ks[0, :2, 2].to(means)
        slopes = (pixels - centre) / focal
        # of a pixel's place by the world's: (focal / z) (row - slope * row of z)
        planes = turn[:2] - slopes[:, :, None] * turn[2]
        planes = planes * focal[:, None]
        seen = torch.einsum("nai,nij,nbj->nab", planes, tensors[rows], planes)
        size = (seen[:, 0, 0] + seen[:, 1, 1]).clamp(min=1e-12)
        double = torch.stack([seen[:, 0, 0] - seen[:, 1, 1], 2 * seen[:, 0, 1]], dim=1)
        double = double / size[:, None] * wanted[rows, None] * (depths > 0)[:, None]
        values = splats.means.new_zeros(len(splats), 2).index_copy(0, rows, double)
        return composite(splats, camera, values)


@dataclass(frozen=True, eq=False)
class TurnedStyle:
    """Features of style pictures at several angles, and how the strokes of each run."""

    directions: Float[Tensor, "T D"]
    kinds: Int[Tensor, " T"]
    """The kind of each feature, of those of the pictures as they are."""
    flows: Float[Tensor, "T 2"]
    """Cosine and sine of twice the angle, as long as the strokes are parallel."""

    def nearest(
        self, feats: Float[Tensor, "P D"], flow: Float[Tensor, "P 2"], favour: Float[Tensor, " K"]
    ) -> Float[Tensor, "P D"]:
        """The most similar of the features whose strokes run as they are to."""
        lengths = feats.float().norm(dim=1, keepdim=True)
        queries = torch.cat([feats.float(), lengths * flow * GUIDED, lengths], dim=1)
        own = favour[self.kinds]
        table = torch.cat([self.directions.float(), self.flows, own[:, None]], dim=1)
        return self.directions.index_select(0, most_similar(queries, table))


@torch.no_grad()
def turned_style(
    network: FeatureNetwork,
    config: StyleConfig,
    images: Sequence[Tensor],
    length: float,
    index: StyleIndex,
) -> TurnedStyle:
    """The features of style images turned by several angles, beside an object so long."""
    turns = [180 * number / GUIDE_TURNS for number in range(GUIDE_TURNS)]
    found = [
        _features_and_flows(_turned(part, degrees), network, config.block, longer)
        for part, longer in style_parts(images, config, length)
        for degrees in turns
    ]
    every, flow = (torch.cat(each) for each in zip(*found, strict=True))
    generator = torch.Generator().manual_seed(config.seed)
    some = torch.randperm(len(every), generator=generator)[:TURNED_FEATURES].to(every.device)
    directions = F.normalize(every[some].float(), dim=1)
    kinds = index.kinds[most_similar(directions, index.directions.float())]
    return TurnedStyle(directions.to(index.directions.dtype), kinds, flow[some])


def _turned(picture: Float[Tensor, "H W 3"], degrees: float) -> Float[Tensor, "H W 3"]:
    """A picture turned about its middle; its corners are filled by reflections."""
    sin, cos = (f(math.radians(degrees)) for f in (math.sin, math.cos))
    matrix = np.array([[cos, sin], [-sin, cos]])  # from rows and columns to those of the picture
    middle = (np.array(picture.shape[:2]) - 1) / 2
    place = {"offset": middle - matrix @ middle, "order": 1, "mode": "mirror"}
    channels = picture.cpu().numpy().transpose(2, 0, 1)
    turned = np.stack([affine_transform(each, matrix, **place) for each in channels], axis=-1)
    return torch.from_numpy(turned).to(picture)


def _features_and_flows(
    picture: Float[Tensor, "H W 3"], network: FeatureNetwork, block: int, length: float
) -> tuple[Float[Tensor, "Q D"], Float[Tensor, "Q 2"]]:
    resized, cells = fit_style(picture, network, block, length), network.cells(block)
    rows, columns = map(cells.inside, resized.shape[:2])
    flow = picture_flow(resized, FLOW_WIDTH * cells.stride * 2)
    flow = F.avg_pool2d(flow.permute(2, 0, 1)[None], cells.stride)[0].permute(1, 2, 0)
    found = network(resized, [block])[0]
    return found[rows, columns].flatten(0, 1), flow[rows, columns].flatten(0, 1)


def picture_flow(picture: Float[Tensor, "H W 3"], width: float) -> Float[Tensor, "H W 2"]:
    """How strokes run: cosine and sine of twice the angle, as long as they are parallel.

    They are those of the structure tensor's smaller eigenvalue, averaged over so many pixels.
    """
    grey = (picture @ picture.new_tensor(LUMA)).cpu().numpy().astype(np.float32)
    x, y = derivative(grey, 1, 0), derivative(grey, 0, 1)
    xx, xy, yy = (blurred(each, width) for each in (x * x, x * y, y * y))
    double = np.stack([yy - xx, -2 * xy], axis=-1) / np.maximum(xx + yy, 1e-9)[..., None]
    return torch.from_numpy(double).to(picture)


@torch.no_grad()
def align_to_strokes(
    splats: Splats, discs: Bool[Tensor, " N"], distance: float, guides: Guides | None = None
) -> Splats:
    """Turn discs along the strokes painted so far, or along lines to follow, and stretch them.

    In each disc's tangent plane the structure tensor of the painted luminance gives the direction
    (the eigenvector of its smaller eigenvalue) and how coherent it is (Weickert 1999). The third
    axis of a disc is its normal, the distance that between neighbouring discs.
    """
    rows = discs.nonzero()[:, 0]
    means, axes = splats.means[rows], rotation_matrices(splats.quats[rows])
    tangents, normals = axes[:, :, :2], axes[:, :, 2]
    far, near = nearest_points(means, means, STROKE_NEIGHBOURS)
    far = far.to(means) / distance
    same_side = (normals[near] * normals[:, None]).sum(dim=2).clamp(min=0)  # [D, k]

    def weights(width: float) -> Tensor:
        return same_side * (-(far / width).square() / 2).exp()

    luma = splats.sh0[rows, 0] @ splats.sh0.new_tensor(LUMA)
    gradients = _gradients(means / distance, tangents, luma, near, weights(GRADIENT_WIDTH))
    local = torch.einsum("dij,dki->dkj", tangents, gradients[near])
    tensors = torch.einsum("dk,dki,dkj->dij", weights(TENSOR_WIDTH), local, local)
    if guides is not None:
        tensors = _along_guides(tensors, tangents, guides.tensors(means))
    # The eigenvectors in closed form: cuSOLVER takes few matrices at once
    twice, sums = 2 * tensors[:, 0, 1], tensors[:, 0, 0] + tensors[:, 1, 1]
    apart = tensors[:, 0, 0] - tensors[:, 1, 1]
    coherence = torch.hypot(apart, twice) / sums.clamp(min=1e-12)
    half = (torch.atan2(twice, apart) + math.pi) / 4  # of the angle to the smaller one's
    stretch = 1 + torch.stack(
        [(LONG - 1) * coherence, (NARROW - 1) * coherence, 0 * coherence], dim=1
    )
    turned = {
        "quats": _turned_in_plane(splats.quats[rows], half.cos(), half.sin()),
        "scales": splats.scales[rows] + stretch.log(),
    }
    return splats.with_rows(rows, turned)


def _along_guides(
    tensors: Float[Tensor, "D 2 2"],
    tangents: Float[Tensor, "D 3 2"],
    around: Float[Tensor, "D 3 3"],
) -> Float[Tensor, "D 2 2"]:
    """Structure tensors, of trace 1, of strokes that follow lines as far as these count."""
    shares = around.diagonal(dim1=1, dim2=2).sum(dim=1)[:, None, None]
    own = torch.einsum("dia,dij,djb->dab", tangents, around, tangents)
    sums = own.diagonal(dim1=1, dim2=2).sum(dim=1)[:, None, None]
    across = torch.eye(2).to(own) - own / sums.clamp(min=1e-12)
    sums = tensors.diagonal(dim1=1, dim2=2).sum(dim=1)[:, None, None]
    return (tensors / sums.clamp(min=1e-12)).lerp(across, shares)


def _gradients(
    points: Float[Tensor, "D 3"],
    tangents: Float[Tensor, "D 3 2"],
    values: Float[Tensor, " D"],
    near: Tensor,
    weights: Float[Tensor, "D k"],
) -> Float[Tensor, "D 3"]:
    """Gradients along the surface, by a weighted fit of a plane to each point's neighbours."""
    total = weights.sum(dim=1, keepdim=True).clamp(min=1e-9)
    offsets = torch.einsum("dki,dij->dkj", points[near] - points[:, None], tangents)
    offsets = offsets - ((weights[..., None] * offsets).sum(dim=1) / total)[:, None]
    changes = values[near] - (weights * values[near]).sum(dim=1, keepdim=True) / total
    normal = torch.einsum("dk,dki,dkj->dij", weights, offsets, offsets)
    right = torch.einsum("dk,dki,dk->di", weights, offsets, changes)
    fitted = torch.linalg.solve(normal + STROKE_RIDGE * torch.eye(2).to(points), right)
    return torch.einsum("dij,dj->di", tangents, fitted)


def _turned_in_plane(
    quats: Float[Tensor, "D 4"], cos: Float[Tensor, " D"], sin: Float[Tensor, " D"]
) -> Float[Tensor, "D 4"]:
    """Rotations after one about their own third axis, by twice the angle of `cos` and `sin`."""
    w, x, y, z = quats.unbind(1)
    turned = [w * cos - z * sin, x * cos + y * sin, y * cos - x * sin, z * cos + w * sin]
    return torch.stack(turned, dim=1)
