"""The size of strokes: at which size of the picture it looks most like what was painted.

    .venv/bin/python benchmarks/strokes.py --scene SCENE --object OBJECT --painting FILE

For some sizes of strokes (`--stroke-size`) the object is painted, and its features in four held-out
views are compared with those of the picture at many sizes. The middle of the sizes of the least
mean distance (NNFM), as a multiple of the object's length, is the size that the strokes seem to
have. It should double when the stroke size does, within a quarter. Lengths of strokes in pixels
cannot be told by correlation or edges: paintings have detail of every size, and give the same
length at every size.

No size is larger than the picture itself, as what is enlarged is soft and resembles everything
soft. So the views are shrunk until the picture, in the size that was asked for, has half of its own
pixels: sizes are told apart up to twice of it, and strokes of every size are as large to the
network.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log
from pathlib import Path
from statistics import mean

import torch
import tyro
from bench import table
from jaxtyping import Bool, Float
from judge import find_sights
from torch import Tensor
from torch.nn import functional as F

import stylesplat as ss
from stylesplat.io.style_pictures import read_style, resize
from stylesplat.rendering.weights import COVERED
from stylesplat.selection.labels import pick
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import FeatureNetwork, load_weights
from stylesplat.stylization.matching import most_similar
from stylesplat.stylization.painter import paint

LAYER = 3  # group of the network's layers, as the default paints with
VIEWS = 4
SIZES = 2.0 ** torch.arange(-1.5, 3.01, 0.25)  # of the picture, in lengths of the object
SIDE = 1000  # pixels of the picture at most: of a larger one the first
FEATURES = 3000  # at random, equally many of each size: more would be nearer
BORDER = 3  # features that see beside the picture
AS_NEAR = 1.01  # ratio to the least distance up to which a picture resembles as much
INSIDE = 0.99  # of a feature's cell that has to be the object's


@dataclass(frozen=True)
class Options:
    """What to paint, and how."""

    scene: Path
    """A scene with objects."""
    painting: Path
    """A picture."""
    object: int = 1
    """A label id."""
    scales: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)


@torch.no_grad()
def apparent_size(
    network: FeatureNetwork,
    painted: Sequence[tuple[Float[Tensor, "H W 3"], Bool[Tensor, "H W"]]],
    picture: Float[Tensor, "_ _ 3"],
    length: float,
) -> tuple[float, float]:
    """The size of a picture that resembles some views of an object most, and the distance to it.

    Args:
        network: Whose features are compared.
        painted: Views, and where the object is in them.
        picture: That the style was taken from.
        length: The object's, in pixels; the size is a multiple of it.
    """
    owns = []
    for image, mask in painted:
        seen = _features(network, image)
        inside = F.interpolate(mask[None, None].float(), seen.shape[:2], mode="area")[0, 0]
        owns.append(_few(seen[inside > INSIDE]))
    found = []
    for size in SIZES[SIZES * length <= max(picture.shape)].tolist():
        style = _features(network, resize(picture, size * length)[:SIDE, :SIDE])
        few = _few(style[BORDER:-BORDER, BORDER:-BORDER].flatten(0, 1))
        nearest = [(own * few[most_similar(own, few)]).sum(dim=1).mean() for own in owns]
        found.append((1 - float(torch.stack(nearest).mean()), size))
    least = min(found)[0]
    alike = [log(size) for distance, size in found if distance <= AS_NEAR * least]
    return exp(mean(alike)), least


def _shrunk(image: Tensor, mask: Tensor, zoom: float) -> tuple[Tensor, Tensor]:
    image = resize(image, zoom * max(image.shape[:2]))
    covered = F.interpolate(mask[None, None].float(), image.shape[:2], mode="area")[0, 0]
    return image, covered > COVERED


def _features(network: FeatureNetwork, image: Tensor) -> Float[Tensor, "h w D"]:
    return F.normalize(network(image, (LAYER,))[0].float(), dim=2)


def _few(rows: Float[Tensor, "P D"]) -> Float[Tensor, "Q D"]:
    chosen = torch.randperm(len(rows), generator=torch.Generator().manual_seed(0))
    return rows[chosen[:FEATURES]]


def main(options: Options) -> None:
    """Print the table."""
    scene, picture = ss.open(options.scene), read_style(options.painting)
    training, held_out = scene.working_views()
    picked = pick(scene.splats, object_id=options.object)
    sights = find_sights(scene.splats, held_out or training, picked, VIEWS)
    network = load_weights("compact", depth=LAYER)
    length = sum(sight.extent for sight in sights) / len(sights)
    rows = []
    for scale in options.scales:
        config = StyleConfig(scale=scale)
        styled = paint(scene.splats, training, picked, picture, config=config)
        zoom = min(1.0, max(picture.shape) / (2 * scale * length))
        painted = [_shrunk(sight.shows(styled), sight.mask, zoom) for sight in sights]
        size, distance = apparent_size(network, painted, picture, zoom * length)
        rows.append([f"{scale:g}", f"{size:.2f}", f"{distance:.3f}"])
    print(table(["stroke size", "seems", "NNFM"], rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
