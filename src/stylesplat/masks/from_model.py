"""`mask --method sam2` and others: label maps of everything that a segmentation model finds."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from stylesplat.errors import StyleSplatError
from stylesplat.masks.checkpoint import MaskCheckpoint, open_checkpoint
from stylesplat.masks.propagation import propagate_through_splat
from stylesplat.masks.quick_splat import with_label_maps, working_splat
from stylesplat.masks.repair import repair_ids
from stylesplat.masks.sam import FAMILIES, Method, load_propagator, load_proposer
from stylesplat.masks.tracking import Segmenter, split_clips, track_clip
from stylesplat.progress import task
from stylesplat.rendering.render import pick_device
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

    `sam` knows single photos; its masks are propagated from photo to photo by the splat.

    Raises:
        StyleSplatError: If the model cannot be had or finds nothing, or another folder is in the
            place of intermediate results.
    """
    small, place = at_most(capture, SIZE), pick_device(device)
    proposer = load_proposer(method, model, place)
    propagator = load_propagator(method, model, place) if FAMILIES[method].video_types else None
    settings = {"method": method, "model": model, "sizes": small.cameras.sizes.tolist()}
    bare = replace(small, label_maps=None, object_names={})
    photos = fingerprint(bare, photos=len(bare))
    settings |= {"photos": photos, "clips": split_clips(small.cameras)}
    with TemporaryDirectory() as temporary:
        checkpoint = open_checkpoint(progress or Path(temporary) / "progress", settings)
        working = working_splat(small, scene, device)
        photos, cameras = working.capture.photos, working.capture.cameras

        def propose(row: int) -> list[Mask]:
            return checkpoint.proposals(row, lambda: proposer.propose(photos[row]))

        def propagate(rows: Sequence[int], seeds: Mapping[int, Mask]) -> list[dict[int, Mask]]:
            if propagator is None:
                return propagate_through_splat(working.splats, cameras, rows, seeds)
            return propagator.propagate([photos[row] for row in rows], seeds)

        def size(row: int) -> tuple[int, int]:
            width, height = cameras[row].size
            return height, width

        segmenter = Segmenter(size, propose, propagate)
        tracked = _track(small, segmenter, checkpoint)
    maps = repair_ids(working.splats, cameras, tracked)
    if not any(labels.any() for labels in maps):
        raise StyleSplatError(
            f"{method} has found no object that several photos confirm. Try another model, or draw "
            "boxes with --box."
        )
    return with_label_maps(
        capture, [partial(maps.__getitem__, row) for row in range(len(maps))], {}
    )


def _track(capture: Capture, segmenter: Segmenter, checkpoint: MaskCheckpoint) -> list[Labels]:
    """The label maps of all photos, from where an earlier run stopped."""
    clips = split_clips(capture.cameras)
    done, state = checkpoint.load()
    with task("finding objects", len(clips), unit="clip", done=done) as bar:
        for number, rows in enumerate(clips[done:], start=done + 1):
            maps, state = track_clip(rows, state, segmenter)
            checkpoint.save(number, maps, state)
            bar.advance()
    return [checkpoint.labels(row) for row in range(len(capture))]
