"""From boxes around an object in a few photos to its masks in all, by way of a splat."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.masks.boxes.grabcut import Box, Evidence, Look, Stroke, cut_box, evidence, refine
from stylesplat.metrics.iou import mask_iou
from stylesplat.progress import Task, task
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import PRIOR, contributed
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import Mask
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import IDENTITY_SIZE, Splats

GROWTH = 2  # times as many views after each round of spreading
SETTLING = 2  # rounds over all views at most
SETTLED = 0.98  # mean IoU with the round before, at which they stop
CLOSER = 2.0  # times more pixels than in any known view, from which a Gaussian is news
FAINT = 0.05  # coverage of a pixel below which its depth means nothing


class Seen(Mapping[int, Evidence]):
    """What GrabCut goes by in each photo of a capture, made on access and kept."""

    def __init__(self, splats: Splats, capture: Capture) -> None:
        self._splats, self._capture = splats, capture
        self._kept: dict[int, Evidence] = {}

    def __len__(self) -> int:
        return len(self._capture)

    def __iter__(self) -> Iterator[int]:
        return iter(range(len(self)))

    def __getitem__(self, row: int) -> Evidence:
        if row not in self._kept:
            nearness = _nearness(self._splats, self._capture.cameras[row])
            self._kept[row] = evidence(self._capture.photos[row], nearness)
        return self._kept[row]


@dataclass(frozen=True)
class Lifted:
    """What the masks of some views say of each Gaussian."""

    rows: frozenset[int]
    """Of these views."""
    votes: Float[Tensor, "N 2"]
    """Its pixels within the masks, and outside."""
    closest: Float[Tensor, " N"]
    """Its pixels in the view that shows it best."""

    @property
    def share(self) -> Float[Tensor, " N"]:
        """How sure each Gaussian belongs to the object; what no view has shown does not."""
        return self.votes[:, 0] / (self.votes.sum(dim=1) + PRIOR)

    def joined(self, other: "Lifted") -> "Lifted":
        """What these views and others say together."""
        closest = torch.maximum(self.closest, other.closest)
        return Lifted(self.rows | other.rows, self.votes + other.votes, closest)


@torch.no_grad()
def spread(
    splats: Splats,
    cameras: Cameras,
    seen: Mapping[int, Evidence],
    boxes: Sequence[tuple[int, Box]],
    strokes: Sequence[tuple[int, Stroke]] = (),
    *,
    name: str = "object",
) -> list[Mask]:
    """The masks of an object in every view, from boxes around it in one or a few.

    GrabCut segments there. The masks are lifted onto the Gaussians, rendered into the nearest
    other views and their contours moved to edges; then the next views, until all have one; then
    all again until they settle.

    Args:
        splats: A scene of the views; its labels do not matter.
        cameras: One per view.
        seen: What GrabCut goes by in each view.
        boxes: Rows of views, and boxes in their pixels, as `refuse_box` lets pass.
        strokes: Rows of views with a box, and strokes in them.
        name: The object's, for who watches.

    Returns:
        A mask per view; empty where the object does not show.

    Raises:
        StyleSplatError: If a box holds nothing that differs from what is around it.
    """
    cuts = {}
    for row, box in boxes:
        drawn = [stroke for at, stroke in strokes if at == row]
        cuts[row] = cut_box(seen[row], box, cameras.names[row], drawn)
    look = cuts[boxes[0][0]][0]
    known = {row: mask for row, (_, mask) in cuts.items()}
    others, lifted = _nearest_first(cameras, [*known]), _lifted(splats, cameras, known)
    with task(f"spreading the mask of {name!r}", (1 + SETTLING) * len(others), unit="view") as bar:
        start = 0
        while start < len(others):
            batch = others[start : start + max(1, (GROWTH - 1) * len(known))]
            found = _refined(splats, cameras, seen, lifted, batch, look, bar=bar)
            known |= found
            lifted = lifted.joined(_lifted(splats, cameras, found))
            start += len(batch)
        for left in reversed(range(SETTLING)):
            again = _refined(splats, cameras, seen, lifted, others, look, bar=bar)
            overlap = [mask_iou(known[row], mask) for row, mask in again.items()]
            known |= again
            if sum(overlap) >= SETTLED * len(overlap):
                bar.advance(left * len(others))  # there is nothing more to do
                break
            lifted = _lifted(splats, cameras, known)
    return [known[row] for row in range(len(cameras))]


def _nearest_first(cameras: Cameras, seeds: Sequence[int]) -> list[int]:
    """The other views, those that look from the side of a seed first."""
    positions, forward = cameras.positions, cameras.viewmats[:, 2, :3]
    size = (positions - positions.mean(dim=0)).norm(dim=1).mean().clamp(min=1e-9)
    apart = torch.cdist(positions, positions[seeds]) / size
    turned = 1 - forward @ forward[list(seeds)].T
    order = (apart + turned).amin(dim=1).argsort().tolist()
    return [row for row in order if row not in seeds]


def _refined(
    splats: Splats,
    cameras: Cameras,
    seen: Mapping[int, Evidence],
    lifted: Lifted,
    rows: Sequence[int],
    look: Look,
    *,
    bar: Task,
) -> dict[int, Mask]:
    """The masks in some views; GrabCut, which takes longest, in several at a time."""
    found: dict[int, Mask] = {}
    threads = torch.get_num_threads()
    with ThreadPoolExecutor(threads) as pool:
        for start in range(0, len(rows), threads):
            group = rows[start : start + threads]
            shown = zip(*(_shown(splats, cameras, lifted, row) for row in group), strict=True)
            masks = pool.map(refine, [seen[row] for row in group], *shown, repeat(look))
            found |= zip(group, masks, strict=True)
            bar.advance(len(group))
    return found


def _shown(
    splats: Splats, cameras: Cameras, lifted: Lifted, row: int
) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
    """The probability of the object in a view, and what is news there; both at each pixel."""
    novel = torch.zeros_like(lifted.closest)
    if row not in lifted.rows:
        novel += _pixels(splats, cameras[row]) > CLOSER * lifted.closest
    carried = torch.stack([lifted.share, novel], dim=1)
    image, _ = render(splats, cameras[row], features=carried, sh_degree=0)
    probability, novelty = image[..., 3:].clamp(0, 1).cpu().unbind(dim=-1)
    return probability, novelty


def _lifted(splats: Splats, cameras: Cameras, masks: Mapping[int, Mask]) -> Lifted:
    votes = splats.means.new_zeros(len(splats), 2)
    closest = splats.means.new_zeros(len(splats))
    for row, mask in masks.items():
        wanted = splats.means.new_zeros(*mask.shape, IDENTITY_SIZE)
        wanted[..., 0], wanted[..., 1] = mask, ~mask
        pixels = contributed(splats, cameras[row], wanted)[:, :2]
        votes += pixels
        closest = torch.maximum(closest, pixels.sum(dim=1))
    return Lifted(frozenset(masks), votes, closest)


def _pixels(splats: Splats, camera: Cameras) -> Float[Tensor, " N"]:
    """How many pixels of a view each Gaussian makes up."""
    width, height = camera.size
    wanted = splats.means.new_zeros(height, width, IDENTITY_SIZE)
    wanted[..., 0] = 1
    return contributed(splats, camera, wanted)[:, 0]


@torch.no_grad()
def _nearness(splats: Splats, camera: Cameras) -> Float[Tensor, "H W"]:
    """One over the depth that shows at each pixel."""
    depths = depths_of(splats.means, camera)
    inverse = 1 / depths.clamp(min=1e-6 * float(depths.abs().max()))
    image, alphas = render(splats, camera, features=inverse[:, None], sh_degree=0)
    return (image[..., 3] / alphas[..., 0].clamp(min=FAINT)).cpu()
