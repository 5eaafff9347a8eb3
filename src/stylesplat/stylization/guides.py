"""Lines on an object that the strokes near them follow.

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
