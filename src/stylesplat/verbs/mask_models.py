"""`mask --method sam2` and others: label maps of everything that a segmentation model finds."""

import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import OBJECT_MASK, open_capture
from stylesplat.masks.ids.repair import repair
from stylesplat.masks.models.sam import FAMILIES, Method, load_follower, load_proposer
from stylesplat.masks.models.through_splat import follow_through
from stylesplat.masks.models.track import Segmenter, stretches, track
from stylesplat.progress import task
from stylesplat.rendering.device import pick_device
from stylesplat.scene.capture import Capture
from stylesplat.verbs.mask import refuse_masks, write_masks
from stylesplat.verbs.mask_progress import Progress, open_progress
from stylesplat.verbs.working import with_splat, working_capture

SIZE = 1024  # pixels of the longer side; the models look at no more

Mask = Bool[Tensor, "H W"]
Labels = Int[Tensor, "H W"]


def mask_with_model(
    capture_path: Path,
    method: Method,
    *,
    model: str | None = None,
    scene: Path | None = None,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Find the objects of all photos with a segmentation model, under ids that agree in 3D.

    What is found is kept beside the label maps until all is done: a run that was interrupted goes
    on when it is started again.

    Args:
        capture_path: The capture's folder.
        method: The model's family. `sam` knows single photos; objects are then followed from
            photo to photo by way of the splat.
        model: Folder or name of a checkpoint; by default a small one of the family.
        scene: A scene of the capture; by default a splat is trained quickly.
        device: Where to compute.
        overwrite: Whether label maps that are there may be replaced.

    Returns:
        As `write_masks` does.

    Raises:
        StyleSplatError: If the model cannot be had or finds nothing, or there are label maps
            already.
    """
    refuse_masks(capture_path, overwrite=overwrite)
    capture = working_capture(capture_path, SIZE)
    place = pick_device(device)
    proposer = load_proposer(method, model, place)
    follower = load_follower(method, model, place) if FAMILIES[method].follower_types else None
    names, sizes = capture.cameras.names, capture.cameras.sizes.tolist()
    settings = {"method": method, "model": model, "sizes": sizes, "photos": _photos(capture_path)}
    settings |= {"stretches": stretches(capture.cameras)}
    progress = open_progress(capture_path / f"{OBJECT_MASK}.partial", settings)
    working = with_splat(capture_path, capture, scene, device)

    def propose(row: int) -> list[Mask]:
        return progress.proposals(row, lambda: proposer.propose(capture.photos[row]))

    def follow_in_photos(rows: Sequence[int], seeds: Mapping[int, Mask]) -> list[dict[int, Mask]]:
        assert follower is not None
        return follower.follow([capture.photos[row] for row in rows], seeds)

    through = partial(follow_through, working.splats, working.capture.cameras)
    segmenter = Segmenter(
        size=lambda row: (sizes[row][1], sizes[row][0]),
        propose=propose,
        follow=follow_in_photos if follower else through,
    )
    maps = repair(working.splats, working.capture.cameras, _tracked(capture, segmenter, progress))
    if not any(labels.any() for labels in maps):
        raise StyleSplatError(
            f"{method} has found no object that several photos confirm. Try another model, or draw "
            "boxes with --box."
        )
    found = {name: partial(maps.__getitem__, row) for row, name in enumerate(names)}
    result = write_masks(capture_path, found, {}, overwrite=overwrite)
    shutil.rmtree(progress.folder)
    return result


def _photos(path: Path) -> list[tuple[str, int, int]]:
    """What tells photos from others: path, size and time of change."""
    files = [photo.path for photo in open_capture(path, masks=False).photos]
    return [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files]


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
