"""Figure 2: the style loss masked in 2D against a selection in 3D, at growing mask error."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from statistics import mean
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

import stylesplat as ss
from paper_figures.book import Cell, Outcome, Results
from paper_figures.story import Block, Figure, Row, Table, Text, digits, percent
from paper_figures.subject import Subject, each, shot
from stylesplat.demo.demo_run import TRAINING
from stylesplat.demo.faults import FaultConfig, corrupt_label_maps
from stylesplat.evaluation.statistics import content_ssim
from stylesplat.metrics.masked_change import changed_share, farther_than, masked_psnr, strength
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.shares import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import resize_labels
from stylesplat.scene.projection import crop
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.stylization.nnfm import nnfm_loss
from stylesplat.stylization.object_views import find_boxes, typical_length
from stylesplat.stylization.target import style_features
from stylesplat.training.lifting import lift

NAME = "figure2"
LEVELS = (0.0, 0.5, 1.0, 2.0)  # times the demo's rates of error
LR = 0.05  # the middle of the paper's Figure 6
SCALE = 2.0  # longer side of the style, in longer sides of the object
MARGIN = 20  # pixels around a mask: what a feature of block 3 sees
REACH = 2.0  # pixels from the object's true border that are not counted as far
CLAIM = (
    "a loss masked in 2D changes wrong Gaussians where masks err, while identities learned from "
    "many noisy masks correct these errors and avoid leakage."
)


def cells(subject: Subject) -> list[Cell]:
    """Both ways at each level of error; without exact masks with those that were given."""
    levels = LEVELS if subject.exact else (1.0,)
    found = [Cell(NAME, "initial", partial(_initial, subject))]
    for level in levels:
        for way in ("2D", "3D"):
            found.append(Cell(NAME, f"{way} at {level:g}", partial(_styled, subject, way, level)))
    return found


def _initial(subject: Subject) -> Outcome:
    camera = subject.best_view(subject.ids[0])
    return Outcome(
        {"object": subject.called(subject.ids[0])}, {"view": shot(subject.splats, camera)}
    )


def _styled(subject: Subject, way: str, level: float) -> Outcome:
    id, effort = subject.ids[0], subject.effort
    noisy = with_errors(subject, level)
    if way == "2D":
        trainable = torch.ones(len(subject.splats), dtype=torch.bool)
        splats, mask_of = subject.splats, partial(_in_2d, noisy, id)
    else:
        splats = segmented(subject, noisy)
        trainable = pick(splats, object_id=id)
        mask_of = partial(_covered, splats, trainable)
    styled = trained_colours(subject, splats, mask_of, trainable, effort.masked_steps)
    numbers = leakage(subject, splats, styled, id)
    numbers["changed_gaussians"] = int((styled.sh0 != splats.sh0).flatten(1).any(dim=1).sum())
    picked = trainable if way == "3D" else subject.picked(id)
    numbers["content_ssim"] = content_ssim(splats, styled, subject.held_out, picked)
    return Outcome(numbers, {"view": shot(styled, subject.best_view(id))})


def with_errors(subject: Subject, level: float) -> Capture:
    """The photos with label maps that err so many times as often as the demo's."""
    if subject.exact is None:
        return subject.capture
    maps = subject.exact.label_maps
    assert maps is not None
    usual = FaultConfig()
    rates = {name: level * getattr(usual, name) for name in ("border", "missing", "merged")}
    config = FaultConfig(**rates, fragments=min(1.0, level * usual.fragments))
    exact = [labels for labels in maps if labels is not None]
    noisy = corrupt_label_maps(exact, seed=0, config=config)
    return replace(subject.exact, label_maps=noisy)


def segmented(subject: Subject, photos: Capture) -> Splats:
    """Gaussians with identities of these label maps: trained with them, or lifted from them."""
    if subject.effort.trained and subject.name == "demo":
        return ss.train(photos, TRAINING).splats
    rows = [photos.cameras.index(name) for name in subject.training.names]
    return lift(subject.splats, photos, rows=rows)


def _in_2d(photos: Capture, id: int, camera: Cameras) -> Tensor | None:
    assert photos.label_maps is not None
    labels = photos.label_maps[photos.cameras.index(camera.names[0])]
    return None if labels is None else resize_labels(labels, camera.size[::-1]) == id


@torch.no_grad()
def _covered(splats: Splats, picked: Tensor, camera: Cameras) -> Tensor:
    return coverage(splats, camera, picked) > COVERED


def trained_colours(
    subject: Subject,
    splats: Splats,
    mask_of: Callable[[Cameras], Tensor | None],
    trainable: Tensor,
    steps: int,
) -> Splats:
    """Train the constant colours of some Gaussians on NNFM inside masks: one loop for both ways."""
    cameras = subject.training.at_most(subject.effort.side)
    found = (_cut(camera, mask_of(camera)) for camera in each(cameras))
    views = [view for view in found if view is not None]
    boxes = find_boxes(subject.splats, cameras, subject.picked(subject.ids[0]))
    style = next(iter(subject.styles.values()))
    length = SCALE * typical_length(boxes)
    target = style_features(style, subject.network, (3,), length=length)[0]
    sh0 = splats.sh0.clone().requires_grad_()
    optimizer = torch.optim.Adam([sh0], lr=LR, eps=1e-15)
    for row in _drawn(len(views), steps):
        camera, mask = views[row]
        feats = subject.network(rasterize(replace(splats, sh0=sh0), camera)[0][0])[0]
        inside = F.interpolate(mask[None, None].float(), feats.shape[:2], mode="nearest")[0, 0] > 0
        if inside.any():
            optimizer.zero_grad()
            nnfm_loss(feats[inside], target).backward()
            assert sh0.grad is not None
            sh0.grad[~trainable] = 0  # Adam leaves what never had a gradient as it is
            optimizer.step()
    return replace(splats, sh0=sh0.detach())


def _cut(camera: Cameras, mask: Tensor | None) -> tuple[Cameras, Tensor] | None:
    """A view and its mask around what features of the mask see; None if it shows nothing."""
    if mask is None or not mask.any():
        return None
    places = mask.nonzero()
    low = (places.amin(dim=0) - MARGIN).clamp(min=0)
    high = torch.minimum(places.amax(dim=0) + 1 + MARGIN, torch.tensor(mask.shape))
    (top, left), (bottom, right) = low.tolist(), high.tolist()
    cut = crop(camera, (left, top), (right - left, bottom - top))
    return cut, mask[top:bottom, left:right]


def _drawn(count: int, steps: int) -> Iterator[int]:
    generator = torch.Generator().manual_seed(0)
    for _ in range(steps):
        yield int(torch.randint(count, (1,), generator=generator))


def leakage(subject: Subject, before: Splats, after: Splats, id: int) -> dict[str, Any]:
    """What changed outside an object's true masks, and inside; means over the held-out views."""
    found: list[dict[str, float]] = []
    for camera in each(subject.held_out):
        mask = subject.true_map(camera) == id
        pair = shot(before, camera), shot(after, camera)
        numbers = {
            "outside_psnr": masked_psnr(*pair, ~mask),
            "changed_outside": changed_share(*pair, ~mask),
            "changed_far": changed_share(*pair, farther_than(mask, REACH)),
        }
        if mask.any():
            numbers["changed_inside"] = changed_share(*pair, mask)
            numbers["strength"] = strength(*pair, mask)
        found.append(numbers)
    names = dict.fromkeys(name for numbers in found for name in numbers)
    return {name: mean(n[name] for n in found if name in n) for name in names}


def told(results: Results) -> list[Block]:
    """The table, and pictures at each level."""
    found = results.get(NAME, {})
    keys = [key for key in found if key != "initial"]
    if not keys:
        return []
    blocks: list[Block] = [Table(_HEADS, [_row(key, found[key].numbers) for key in keys])]
    for way in ("2D", "3D"):
        shown = {"initial": found["initial"].pictures["view"]} if "initial" in found else {}
        shown |= {key: found[key].pictures["view"] for key in keys if key.startswith(way)}
        blocks.append(Row(shown))
    return [*blocks, Text(_conclusion(found, keys))]


_HEADS = ("masks", "outside PSNR", "changed outside", "more than 2 px outside")
_HEADS += ("changed inside", "strength (Lab)", "content SSIM", "changed Gaussians")


def _row(key: str, numbers: Any) -> list[str]:
    return [
        f"{key} x the error" if " at " in key else key,
        f"{digits(numbers['outside_psnr'], 1)} dB",
        *(percent(numbers[name]) for name in ("changed_outside", "changed_far")),
        percent(numbers["changed_inside"], 0),
        digits(numbers["strength"], 1),
        digits(numbers["content_ssim"]),
        f"{numbers['changed_gaussians']:,}",
    ]


def _conclusion(found: Any, keys: Sequence[str]) -> str:
    """What the numbers say, made of them."""
    levels = [key.removeprefix("2D at ") for key in keys if key.startswith("2D")]
    both = [level for level in levels if f"3D at {level}" in found]
    better = [
        level
        for level in both
        if found[f"2D at {level}"].numbers["changed_far"]
        > found[f"3D at {level}"].numbers["changed_far"]
    ]
    exact = "0" in both and found["2D at 0"].numbers["changed_far"]
    line = (
        "Masking in 2D changes more pixels that are more than 2 px outside the object than "
        f"selecting in 3D does at {len(better)} of {len(both)} levels of error."
    )
    if exact:
        line += (
            f" With exact masks it still changes {percent(exact)} of them: Gaussians reach over "
            "the border, and what one view hides another shows."
        )
    return line


FIGURE = Figure(NAME, "Figure 2: leakage", CLAIM, cells, told)
