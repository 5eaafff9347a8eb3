"""`mask --method sam2` and others: label maps of everything that a segmentation model finds."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from stylesplat.errors import StyleSplatError
from stylesplat.masks.ids.repair import repair
from stylesplat.masks.models.found_so_far import Progress, open_progress
from stylesplat.masks.models.sam import (
    FAMILIES,
    Follower,
    Method,
    Proposer,
    load_follower,
    load_proposer,
)
from stylesplat.masks.models.through_splat import follow_through
from stylesplat.masks.models.track import Segmenter, stretches, track
from stylesplat.masks.quick_splat import Working, with_maps, with_splat
from stylesplat.progress import task
from stylesplat.rendering.device import pick_device
from stylesplat.scene.capture import Capture, at_most, fingerprint
from stylesplat.scene.labels import Labels, Mask
from stylesplat.scene.scene import Scene

SIZE = 1024  # pixels of the longer side; the models look at no more


def mask_with_model(
    capture: Capture,
    method: Method,
    *,
    model: str | None,
    scene: Scene | None,
    device: str,
    progress: Path | None,
) -> Capture:
    """Find the objects of all photos with a segmentation model, under ids that agree in 3D.

    `sam` knows single photos; objects are then followed from photo to photo by way of the splat.

    Raises:
        StyleSplatError: If the model cannot be had or finds nothing, or another folder is in the
            place of intermediate results.
    """
    small, place = at_most(capture, SIZE), pick_device(device)
    proposer = load_proposer(method, model, place)
    follower = load_follower(method, model, place) if FAMILIES[method].follower_types else None
    settings = {"method": method, "model": model, "sizes": small.cameras.sizes.tolist()}
    bare = replace(small, label_maps=None, object_names={})  # what it had does not matter
    photos = fingerprint(bare, photos=len(bare))
    settings |= {"photos": photos, "stretches": stretches(small.cameras)}
    with TemporaryDirectory() as temporary:
        kept = open_progress(progress or Path(temporary) / "progress", settings)
        working = with_splat(small, scene, device)
        segmenter = _segmenter(working, proposer, follower, kept)
        tracked = _tracked(small, segmenter, kept)
    maps = repair(working.splats, working.capture.cameras, tracked)
    if not any(labels.any() for labels in maps):
        raise StyleSplatError(
            f"{method} has found no object that several photos confirm. Try another model, or draw "
            "boxes with --box."
        )
    return with_maps(capture, [partial(maps.__getitem__, row) for row in range(len(maps))], {})


def _segmenter(
    working: Working, proposer: Proposer, follower: Follower | None, kept: Progress
) -> Segmenter:
    """The model on these photos; it is asked once what a photo shows."""
    capture, sizes = working.capture, working.capture.cameras.sizes.tolist()

    def propose(row: int) -> list[Mask]:
        return kept.proposals(row, lambda: proposer.propose(capture.photos[row]))

    def follow_in_photos(rows: Sequence[int], seeds: Mapping[int, Mask]) -> list[dict[int, Mask]]:
        assert follower is not None
        return follower.follow([capture.photos[row] for row in rows], seeds)

    through = partial(follow_through, working.splats, capture.cameras)
    return Segmenter(
        size=lambda row: (sizes[row][1], sizes[row][0]),
        propose=propose,
        follow=follow_in_photos if follower else through,
    )


def _tracked(capture: Capture, segmenter: Segmenter, progress: Progress) -> list[Labels]:
    """The label maps of all photos, from where an earlier run stopped."""
    parts = stretches(capture.cameras)
    done, state = progress.stands()
    with task("finding objects", len(parts), unit="stretch", done=done) as bar:
        for number, rows in enumerate(parts[done:], start=done + 1):
            maps, state = track(rows, state, segmenter)
            progress.save(number, maps, state)
            bar.advance()
    return [progress.labels(row) for row in range(len(capture))]
