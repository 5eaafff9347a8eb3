"""Objects repainted in their styles: one, one step by step, or several of a scene."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import task
from stylesplat.runtime import tidy_heap
from stylesplat.scene.cache import GIB
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.compose import compose, family_of
from stylesplat.scene.layer import Layer, without_identities
from stylesplat.scene.splats import Splats
from stylesplat.stylization.cut_scene import CutScene, cut_scene
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.features.precision import fastest_dtype
from stylesplat.stylization.features.weights import load_weights
from stylesplat.stylization.object_views import Box, find_boxes
from stylesplat.stylization.plain_settings import plain
from stylesplat.stylization.repaint import Repainted, Sight, look_at, repaint
from stylesplat.stylization.style_config import DEFAULT_NETWORK, Precision, StyleConfig
from stylesplat.stylization.style_images import Picture, read_style
from stylesplat.stylization.style_job import Studio, StyleJob

MIN_GAUSSIANS = 50  # fewer cannot show a texture
MAX_MEMORY = 1.5  # GiB of linear views; with the rest it stays below 3
LEAST_WEIGHT = 1e-6  # of a Gaussian that does not show, in means
REPORT_EVERY = 10  # steps between two updates of the loss shown


def paint(
    splats: Splats,
    capture: Capture | Cameras,
    picked: Bool[Tensor, " N"],
    style: Picture,
    *,
    config: StyleConfig | None = None,
    network: FeatureNetwork | None = None,
) -> Splats:
    """Repaint one object in the style of a picture.

    Nothing but the picked Gaussians changes: of these the colours, and what a fresh canvas hides of
    them fades. New ones follow all others.

    Args:
        splats: The scene.
        capture: Views from which to look at the object; their photos are not used.
        picked: The object's Gaussians.
        style: A picture's file, or its colours: floats in 0..1, or bytes.
        config: Settings; see `StyleConfig` and `PRESETS`.
        network: Whose features are matched; the package's own by default.

    Raises:
        StyleSplatError: As `paint_objects` does, and if the picture is unreadable.
    """
    studio, job = _one_object(splats, capture, picked, style, config, network)
    return _blended(_last_state(studio, job), studio.splats, job)


def paint_live(
    splats: Splats,
    capture: Capture | Cameras,
    picked: Bool[Tensor, " N"],
    style: Picture,
    *,
    config: StyleConfig | None = None,
    network: FeatureNetwork | None = None,
) -> Iterator[Repainted]:
    """As `paint`, step by step, to show it, to stop early or to go on later.

    Example::

        live = paint_live(splats, capture, picked, "wave.jpg")
        for state in live:
            show(state.splats)
            if state.step == 100:
                break  # keep state.splats, or go on: `for state in live`

    Yields:
        The state after every step, at the intensity of `config`.

    Raises:
        StyleSplatError: As `paint` does.
    """
    studio, job = _one_object(splats, capture, picked, style, config, network)
    for state in repaint(studio, job):
        yield replace(state, splats=_blended(state, studio.splats, job))


@dataclass(frozen=True)
class Styled:
    """A splat and the layers that were painted on it."""

    base: Splats
    """The splat beneath the layers."""
    layers: tuple[Layer, ...]
    """One for each object, the lowest first."""

    @property
    def splats(self) -> Splats:
        """What it looks like."""
        return compose(self.base, self.layers)

    @property
    def parents(self) -> Int[Tensor, " M"]:
        """The row of the base that each row of `splats` belongs to."""
        return family_of(self.base, self.layers)


def paint_objects(studio: Studio, jobs: Sequence[StyleJob]) -> tuple[Styled, dict[str, float]]:
    """Repaint several objects one after the other, each on what is painted before.

    Args:
        studio: The scene, and views to optimise on.
        jobs: Which Gaussians take which style, the lowest layer first.

    Returns:
        The styled scene, and by name the seconds that each object took.

    Raises:
        StyleSplatError: If two objects have the same name, an object has too few Gaussians or is
            not seen, or a style image is too small.
    """
    check_jobs(jobs)
    jobs = [moved(job, studio.splats) for job in jobs]
    if len(jobs) > 1:
        for job in jobs:
            check_sight(studio, job)
    base, layers, seconds = studio.splats, list[Layer](), dict[str, float]()
    for job in jobs:
        began, family = time.perf_counter(), family_of(base, layers)
        upon = replace(studio, splats=compose(base, layers))
        layer, *_ = paint_layer(upon, replace(job, picked=job.picked[family]), family)
        layers.append(layer)
        seconds[job.name] = time.perf_counter() - began
    return Styled(base, tuple(layers)), seconds


def check_sight(studio: Studio, job: StyleJob) -> None:
    """Check that an object can be painted, which takes a while, but less than painting it.

    Raises:
        StyleSplatError: If it is not seen, or a style image is too small.
    """
    look_at(*_within(cut_scene(studio, job.picked), studio, job), closely=True)


def paint_layer(
    studio: Studio, job: StyleJob, family: Int[Tensor, " M"]
) -> tuple[Layer, CutScene | None, Sequence[Box]]:
    """Paint an object on what lies beneath its layer.

    Args:
        studio: Its splats are what lies beneath.
        job: The object, on the same device.
        family: The row of the base that each of the Gaussians beneath belongs to.

    Returns:
        The layer; of a large scene the part that it was painted in; and the boxes of the object in
        all views, held-out ones included.
    """
    cut = cut_scene(studio, job.picked)
    part, own = _within(cut, studio, job)
    sight = look_at(part, own)
    state = _last_state(part, own, sight)
    layer = layer_of(state, own, family if cut is None else family[cut.rows])
    held_out = part.every_camera[len(part.cameras) :]
    survey = [*sight.survey, *find_boxes(part.splats, held_out, sight.ground.job.picked)]
    tidy_heap()  # copies of the whole scene follow
    return layer, cut, survey


def layer_of(state: Repainted, job: StyleJob, family: Int[Tensor, " M"]) -> Layer:
    """An object that is painted as a layer.

    A row of the base stands for the Gaussians of layers beneath that belong to it, too: its paint
    is their mean.

    Args:
        state: How far the painting is.
        job: The object.
        family: The row of the base that each of the Gaussians beneath belongs to.
    """
    count, own = len(family), job.picked.nonzero()[:, 0]
    before, after = state.base, state.splats.detach()
    visible = torch.sigmoid(before.opacities[own])
    fading = after.opacities[own] != before.opacities[own]
    factors = (torch.sigmoid(after.opacities[own]) / visible).clamp(0, 1)
    rows, members = family[own].unique(return_inverse=True)
    mean = partial(_means, members=members, weights=visible.clamp(min=LEAST_WEIGHT))
    canvas = without_identities(after[count:])
    config = plain(job.config)
    return Layer(
        object=job.name,
        rows=rows,
        shares=torch.ones_like(rows, dtype=after.means.dtype),
        sh0=mean(after.sh0[own]),
        shN=mean(after.shN[own]),
        opacity_factors=mean(torch.where(fading, factors, torch.ones_like(factors))),
        canvas=canvas,
        canvas_sh0=before.sh0[count:],
        parents=family[state.parents[count:]],
        relief=torch.cat([mean(state.relief[own]), state.relief[count:]]),
        strength=job.config.intensity,
        form=float(config.get("form", 0.0)),
        settings=config,
    )


def _means(
    values: Float[Tensor, "O *_"], members: Int[Tensor, " O"], weights: Float[Tensor, " O"]
) -> Float[Tensor, "R *_"]:
    """The weighted means of groups of values; of a single value that, to the bit."""
    count = int(members.max()) + 1
    if count == len(members):
        return values.new_empty(values.shape).index_copy_(0, members, values)
    shape = (-1, *(1,) * (values.dim() - 1))
    sums = values.new_zeros(count, *values.shape[1:])
    sums.index_add_(0, members, values * weights.view(shape))
    total = weights.new_zeros(count).index_add_(0, members, weights)
    means = sums / total.view(shape)
    single = (members.bincount(minlength=count) == 1)[members]
    return means.index_copy_(0, members[single], values[single])


def _within(cut: CutScene | None, studio: Studio, job: StyleJob) -> tuple[Studio, StyleJob]:
    """What an object is painted in: the scene, or the part of a large one."""
    return (studio, job) if cut is None else (cut.studio(studio), cut.job(job))


def open_studio(
    splats: Splats,
    cameras: Cameras,
    network: FeatureNetwork,
    *,
    held_out: Cameras | None = None,
    max_memory: float = MAX_MEMORY,
    precision: Precision | None = None,
) -> Studio:
    """What repainting needs besides a job.

    Args:
        splats: The scene.
        cameras: Views to optimise on.
        network: Whose features are matched.
        held_out: More views in which nothing but the object may change.
        max_memory: GiB that linear views may take; see `cut_views`.
        precision: In which features are computed; by default what is fastest on this machine.

    Raises:
        StyleSplatError: If `max_memory` is negative.
    """
    if not max_memory >= 0:
        raise StyleSplatError(f"Cannot keep views in {max_memory} GiB. Pass 0 or more.")
    device = splats.device
    return Studio(
        splats=splats.detach(),
        cameras=cameras,
        every_camera=cameras if held_out is None else cameras + held_out,
        network=network.to(device),
        precision=getattr(torch, precision) if precision else fastest_dtype(device.type),
        max_memory=max_memory * GIB,
    )


def _one_object(
    splats: Splats,
    capture: Capture | Cameras,
    picked: Bool[Tensor, " N"],
    style: Picture,
    config: StyleConfig | None,
    network: FeatureNetwork | None,
) -> tuple[Studio, StyleJob]:
    """What `paint` and `paint_live` are given, checked."""
    config = config or StyleConfig()
    cameras = capture.cameras if isinstance(capture, Capture) else capture
    network = network or load_weights(DEFAULT_NETWORK, depth=max(config.layers))
    image = read_style(style, rotate=config.rotate, region=config.region)
    job = StyleJob("object", picked, (image,), config)
    check_jobs([job])
    return open_studio(splats, cameras, network), moved(job, splats)


def moved(job: StyleJob, splats: Splats) -> StyleJob:
    """The job on the device of the splats."""
    styles = tuple(style.to(splats.means) for style in job.styles)
    return replace(job, picked=job.picked.to(splats.device), styles=styles)


def _last_state(studio: Studio, job: StyleJob, sight: Sight | None = None) -> Repainted:
    """All steps of one object, with a progress bar."""
    state = None
    with task(job.name, job.config.all_steps) as bar:
        for state in repaint(studio, job, sight):
            bar.advance()
            if state.step % REPORT_EVERY == 0:
                bar.note(f"NNFM {state.nnfm:.3f}")
    assert state is not None  # there is at least one step
    return state


def _blended(state: Repainted, splats: Splats, job: StyleJob) -> Splats:
    """The splats with what is painted so far, at the intensity that is wanted."""
    if job.config.intensity == 1:
        return state.splats
    rows = torch.arange(len(splats), device=splats.device)
    return compose(splats, [layer_of(state, job, rows)])


def check_jobs(jobs: Sequence[StyleJob]) -> None:
    """Raise a StyleSplatError if these objects cannot be repainted in one scene."""
    if not jobs:
        raise StyleSplatError("Nothing to stylise: name at least one object and its style.")
    for job in jobs:
        count = int(job.picked.sum())
        if count < MIN_GAUSSIANS:
            raise StyleSplatError(
                f"Cannot stylise {job.name}: it has {count} Gaussians, too few for a texture "
                f"(at least {MIN_GAUSSIANS}). Pick more of it."
            )
    names = set[str]()
    for job in jobs:
        if job.name in names:
            raise StyleSplatError(
                f"{job.name} was given twice. Give it once; several pictures make one style: "
                f"{job.name}=a.jpg,b.jpg."
            )
        names.add(job.name)
