"""Objects repainted in their styles: one, one step by step, or several of a scene."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import task
from stylesplat.runtime import tidy_heap
from stylesplat.scene.cache import GIB
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.stylization.crossfade import crossfade
from stylesplat.stylization.cut_scene import CutScene, cut_scene
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.features.precision import fastest_dtype
from stylesplat.stylization.features.weights import load_weights
from stylesplat.stylization.repaint import Repainted, Sight, look_at, repaint
from stylesplat.stylization.style_config import DEFAULT_NETWORK, Precision, StyleConfig
from stylesplat.stylization.style_images import Picture, read_style
from stylesplat.stylization.style_job import Studio, StyleJob
from stylesplat.stylization.styled_scene import Piece, Styled, assembled, piece_of

MIN_GAUSSIANS = 50  # fewer cannot show a texture
MAX_MEMORY = 1.5  # GiB of linear views; with the rest it stays below 3
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
    them fades, or those too large to show strokes are split. New ones follow all others.

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
    return _repaint_whole(studio, job).splats


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
        yield state if job.config.intensity == 1 else replace(state, splats=blended(state, job))


def paint_objects(studio: Studio, jobs: Sequence[StyleJob]) -> tuple[Styled, dict[str, float]]:
    """Repaint several objects, each in its own style and by itself: their order is immaterial.

    Args:
        studio: The scene, and views to optimise on.
        jobs: Which Gaussians take which style.

    Returns:
        The styled scene, and by name the seconds that each object took.

    Raises:
        StyleSplatError: If two objects share Gaussians or a name, an object has too few or is
            not seen, or a style image is too small.
    """
    check_jobs(jobs)
    jobs = [moved(job, studio.splats) for job in jobs]
    found, pieces, seconds = [], [], {}
    for job in jobs:  # all are looked at before time goes into painting one
        began = time.perf_counter()
        found.append(_looked_at(studio, job, closely=len(jobs) > 1))
        seconds[job.name] = time.perf_counter() - began
    for job, (cut, sight) in zip(jobs, found, strict=True):
        began = time.perf_counter()
        pieces.append(_painted_alone(studio, job, cut, sight))
        seconds[job.name] += time.perf_counter() - began
    cuts = {job.name: cut for job, (cut, _) in zip(jobs, found, strict=True) if cut is not None}
    return replace(assembled(studio.splats, pieces), cuts=cuts), seconds


def _looked_at(
    studio: Studio, job: StyleJob, *, closely: bool
) -> tuple[CutScene | None, Sight | None]:
    """The part of a large scene that an object is painted in, or how it looks in a small one.

    How it looks in a part holds a copy of that.
    """
    cut = cut_scene(studio, job.picked)
    sight = look_at(*_within(cut, studio, job), closely=True) if closely else None
    return cut, sight if cut is None else None


def _within(cut: CutScene | None, studio: Studio, job: StyleJob) -> tuple[Studio, StyleJob]:
    """What an object is painted in: the scene, or the part of a large one."""
    return (studio, job) if cut is None else (cut.studio(studio), cut.job(job))


def _painted_alone(
    studio: Studio, job: StyleJob, cut: CutScene | None, sight: Sight | None
) -> Piece:
    """What becomes of an object."""
    alone = _repaint_whole(*_within(cut, studio, job), sight)
    if cut is None:
        return piece_of(alone, job.picked)
    piece = piece_of(alone, job.picked[cut.rows], cut.rows)
    del alone
    tidy_heap()  # copies of the whole scene follow
    return piece


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


def _repaint_whole(studio: Studio, job: StyleJob, sight: Sight | None = None) -> Styled:
    """All steps of one object, with a progress bar."""
    state = None
    with task(job.name, job.config.all_steps) as bar:
        for state in repaint(studio, job, sight):
            bar.advance()
            if state.step % REPORT_EVERY == 0:
                bar.note(f"NNFM {state.nnfm:.3f}")
    assert state is not None  # there is at least one step
    return Styled(blended(state, job), state.splats, state.base, state.parents)


def blended(state: Repainted, job: StyleJob) -> Splats:
    """The state at the intensity that is wanted."""
    mask = job.picked[state.parents]
    return crossfade(state.base, state.splats, mask, job.config.intensity)


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
    apart = _apart(jobs)
    for one, other in combinations(jobs, 2):
        shared = 0 if apart else int((one.picked & other.picked).sum())
        if one.name == other.name:
            raise StyleSplatError(
                f"{one.name} was given twice. Give it once; several pictures make one style: "
                f"{one.name}=a.jpg,b.jpg."
            )
        if shared:
            raise StyleSplatError(
                f"Cannot stylise {one.name} and {other.name} at once: they share {shared} "
                f"Gaussians. Pick objects that do not overlap."
            )


def _apart(jobs: Sequence[StyleJob]) -> bool:
    """Whether no two objects share Gaussians; pairs need not be looked at then."""
    taken = torch.zeros_like(jobs[0].picked)
    for job in jobs:
        taken |= job.picked
    return int(taken.sum()) == sum(int(job.picked.sum()) for job in jobs)
