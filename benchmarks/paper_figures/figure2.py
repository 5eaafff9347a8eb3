"""Figure 2: the style loss masked in 2D against a selection in 3D, at growing mask error.

One loop for all: the same views, steps, rate and style, constant colours trained with Adam. Masked
in 2D all Gaussians are trainable; in S2RF's way the features under the mask count, whose neighbours
beyond it then get gradients too, and in a stricter one the network sees the scene before where the
mask is not, so that none does. Adam divides gradients by their size, so that what hardly shows
under a mask moves as fast as what fills it: once more with an epsilon that damps this. In 3D the
Gaussians of the object are trainable, and what it covers counts.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from statistics import mean
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

import stylesplat as ss
from paper_figures.book import Cell, Outcome, Results
from paper_figures.masked_change import changed_share, masked_psnr, strength
from paper_figures.story import Block, Figure, Row, Table, Text, digits, percent
from paper_figures.subject import JOINT_TRAINING, Subject, each, shot
from still_life.label_faults import FaultConfig, corrupt_label_maps
from stylesplat.evaluation.changes import farther_than
from stylesplat.evaluation.style import content_ssim
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, resize_labels
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import pick
from stylesplat.stylization.matching import build_index, cosine_distance
from stylesplat.stylization.style import style_features
from stylesplat.stylization.views import find_boxes, typical_length
from stylesplat.training.lifting import lift

NAME = "figure2"
LEVELS = (0.0, 0.5, 1.0, 2.0)  # times the demo's rates of error
EPS = 1e-15  # of Adam, as in the code of 3D Gaussian splatting
DAMPING = 1e-5  # an epsilon next to which small gradients make small steps
MASKED, STRICT = "2D, features masked", "2D, pixels masked"
DAMPED = f"2D, pixels masked, Adam's epsilon {DAMPING:g}"
LIFTED, TRAINED = "3D, lifted", "3D, trained"
WAYS = (MASKED, STRICT, DAMPED, LIFTED, TRAINED)
SHOWN = (MASKED, STRICT, DAMPED, LIFTED)
LR = 0.05  # the middle of the paper's Figure 6
SCALE = 2.0  # longer side of the style, in longer sides of the object
MARGIN = 20  # pixels around a mask: what a feature of block 3 sees
WHOLE = 10**6  # pixels around it, to the frame's end
REACH = 2.0  # pixels from the object's true border that are not counted as far
CLAIM = (
    "a loss masked in 2D changes the wrong Gaussians where masks have errors; identities learned "
    "from many noisy masks correct these errors and avoid leakage."
)


def cells(subject: Subject) -> list[Cell]:
    """Both ways at each level of error; without exact masks with those that were given.

    Training is one of them where identities were learned: others were lifted in the first place.
    """
    levels = LEVELS if subject.exact else (1.0,)
    anew = subject.effort.trained and subject.name == "demo"
    found = [Cell(NAME, "initial", partial(_initial, subject))]
    for way in WAYS:
        for level in levels:
            if way != TRAINED or (subject.joint and (level == 1 or anew)):
                styled = partial(_styled, subject, way, level)
                found.append(Cell(NAME, f"{way} at {level:g}", styled))
    return found


def _initial(subject: Subject) -> Outcome:
    camera = subject.best_view(subject.ids[0])
    return Outcome(
        {"object": subject.called(subject.ids[0])}, {"view": shot(subject.splats, camera)}
    )


def _styled(subject: Subject, way: str, level: float) -> Outcome:
    id = subject.ids[0]
    noisy = with_errors(subject, level)
    if way in (MASKED, STRICT, DAMPED):
        splats, picked = subject.splats, subject.picked(id)
        trainable, mask_of = torch.ones_like(picked), partial(_in_2d, noisy, id)
    else:
        splats = segmented(subject, noisy, way, level)
        trainable = picked = pick(splats, object_id=id)
        mask_of = partial(_covered, splats, trainable)
    eps = DAMPING if way == DAMPED else EPS
    task = Task(mask_of, trainable, strict=way in (STRICT, DAMPED), eps=eps)
    styled = trained_colours(subject, splats, task)
    numbers = leakage(subject, splats, styled, id)
    numbers["changed_gaussians"] = int((styled.sh0 != splats.sh0).flatten(1).any(dim=1).sum())
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


def segmented(subject: Subject, photos: Capture, way: str, level: float) -> Splats:
    """Gaussians with identities of these label maps: trained with them, or lifted from them.

    The scene itself was trained with those that were given.
    """
    if way == TRAINED:
        return subject.splats if level == 1 else _joint(photos)
    rows = [photos.cameras.index(name) for name in subject.training.names]
    return lift(subject.splats, photos, rows=rows)


def _joint(photos: Capture) -> Splats:
    return ss.train(photos, JOINT_TRAINING, segment="joint").splats


def _in_2d(photos: Capture, id: int, camera: Cameras) -> Tensor | None:
    assert photos.label_maps is not None
    labels = photos.label_maps[photos.cameras.index(camera.names[0])]
    return None if labels is None else resize_labels(labels, camera.size[::-1]) == id


@torch.no_grad()
def _covered(splats: Splats, picked: Tensor, camera: Cameras) -> Tensor:
    return coverage(splats, camera, picked) > COVERED


@dataclass(frozen=True)
class Task:
    """What differs between the ways."""

    mask_of: Callable[[Cameras], Tensor | None]
    """The pixels of a view whose features count."""
    trainable: Tensor
    """Which Gaussians take other colours."""
    strict: bool = False
    """Whether the network sees the scene before where the mask is not."""
    eps: float = EPS
    """Of Adam, which divides gradients by their size and this."""
    black: bool = False
    """Whether the network sees the whole frame, black where the mask is not, and all counts."""
    style: Tensor | None = None
    """The picture; by default the first of the scene's."""
    printed: bool = False
    """Whether to minimise what the paper prints: each feature's least product with the style's."""


def trained_colours(subject: Subject, splats: Splats, task: Task) -> Splats:
    """Train the constant colours of some Gaussians on NNFM inside masks: one loop for all."""
    cameras = subject.training.at_most(subject.effort.side)
    margin = WHOLE if task.black else MARGIN
    found = (_cut(camera, task.mask_of(camera), margin) for camera in each(cameras))
    views = [view for view in found if view is not None]
    boxes = find_boxes(subject.splats, cameras, subject.picked(subject.ids[0]))
    style = next(iter(subject.styles.values())) if task.style is None else task.style
    length = SCALE * typical_length(boxes)
    target = style_features(style, subject.network, 3, length=length)
    sign = -1 if task.printed else 1
    index = build_index(sign * target, target.dtype)  # as the package does: NNFM within 0.1 %
    sh0 = splats.sh0.clone().requires_grad_()
    optimizer = torch.optim.Adam([sh0], lr=LR, eps=task.eps)
    for row in _drawn(len(views), subject.effort.masked_steps):
        camera, mask = views[row]
        image = rasterize(replace(splats, sh0=sh0), camera)[0][0]
        if task.strict:
            image = torch.where(mask[..., None], image, shot(splats, camera))
        if task.black:
            image = image * mask[..., None]
        feats = subject.network(image)[0]
        counted = (mask | task.black)[None, None].float()
        inside = F.interpolate(counted, feats.shape[:2], mode="nearest")[0, 0] > 0
        if inside.any():
            optimizer.zero_grad()
            own = feats[inside]
            matches, _ = index.nearest(own.detach(), index.no_favour())
            (sign * cosine_distance(own, target[matches])).backward()
            assert sh0.grad is not None
            sh0.grad[~task.trainable] = 0  # Adam leaves what never had a gradient as it is
            optimizer.step()
    return replace(splats, sh0=sh0.detach())


def _cut(camera: Cameras, mask: Tensor | None, margin: int) -> tuple[Cameras, Tensor] | None:
    """A view and its mask around what features of the mask see; None if it shows nothing."""
    if mask is None or not mask.any():
        return None
    places = mask.nonzero()
    low = (places.amin(dim=0) - margin).clamp(min=0)
    high = torch.minimum(places.amax(dim=0) + 1 + margin, torch.tensor(mask.shape))
    (top, left), (bottom, right) = low.tolist(), high.tolist()
    cut = camera.crop((left, top), (right - left, bottom - top))
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
    for way in SHOWN:
        shown = {"initial": found["initial"].pictures["view"]} if "initial" in found else {}
        shown |= {key: found[key].pictures["view"] for key in keys if key.startswith(f"{way} at")}
        blocks += [Row(shown)] if len(shown) > 1 else []
    said = [_conclusion(found, way) for way in (MASKED, STRICT, DAMPED)] + [_adam(found)]
    return [*blocks, *(Text(line) for line in said if line)]


_HEADS = ("masks", "outside PSNR", "changed outside", "more than 2 px outside")
_HEADS += ("changed inside", "strength (Lab)", "content SSIM", "changed Gaussians")


def _row(key: str, numbers: Any) -> list[str]:
    return [
        f"{key} x the error",
        f"{digits(numbers['outside_psnr'], 1)} dB",
        *(percent(numbers[name]) for name in ("changed_outside", "changed_far")),
        percent(numbers["changed_inside"], 0),
        digits(numbers["strength"], 1),
        digits(numbers["content_ssim"]),
        f"{numbers['changed_gaussians']:,}",
    ]


def _conclusion(found: Any, way: str) -> str | None:
    """What the numbers say of one way to mask, made of them; None without any."""
    ends = [key.removeprefix(way) for key in found if key.startswith(f"{way} at")]
    pairs = [
        tuple(found[f"{each_}{end}"].numbers["changed_far"] for each_ in (way, LIFTED))
        for end in ends
        if f"{LIFTED}{end}" in found
    ]
    if not pairs:
        return None
    more = sum(masked > selected for masked, selected in pairs)
    largest = [percent(max(column)) for column in zip(*pairs, strict=True)]
    return (
        f'"{way}" changes more pixels farther than 2 px from the object than a lifted selection '
        f"does, at {more} of {len(pairs)} levels of error: at most {largest[0]}, against "
        f"{largest[1]}."
    )


def _adam(found: Any) -> str | None:
    """What the optimiser alone is to blame for: masks are exact, epsilons differ."""
    keys = f"{STRICT} at 0", f"{DAMPED} at 0"
    if not all(key in found for key in keys):
        return None
    usual, damped = (percent(found[key].numbers["changed_far"]) for key in keys)
    levels = [
        percent(result.numbers["changed_far"])
        for key, result in found.items()
        if key.startswith(f"{DAMPED} at")
    ]
    return (
        f"With exact masks, {usual} of the pixels beyond 2 px change if Adam's epsilon is {EPS:g}, "
        f"and {damped} if it is {DAMPING:g}: the optimiser causes the difference, not the masks. "
        f"With the larger epsilon the shares by level of error are {', '.join(levels)}."
    )


FIGURE = Figure(NAME, "Figure 2: leakage", CLAIM, cells, told)
