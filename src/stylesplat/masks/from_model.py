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
from stylesplat.masks.tracking import Segmenter, TrackingState, split_clips, track_clip
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
    bare = replace(small, label_maps=None, object_names={})
    settings = {
        "method": method,
        "model": model,
        "sizes": small.cameras.sizes.tolist(),
        "photos": fingerprint(bare, photos=len(bare)),
        "clips": split_clips(small.cameras),
    }
    with TemporaryDirectory() as temporary:
        checkpoint = open_checkpoint(progress or Path(temporary) / "progress", settings)
        working = working_splat(small, scene, device)
        photos, cameras = working.capture.photos, working.capture.cameras

        def propose(row: int) -> list[Mask]:
            return [mask.cpu() for mask in proposer.propose(photos[row])]

        def propagate(rows: Sequence[int], seeds: Mapping[int, Mask]) -> list[dict[int, Mask]]:
            if propagator is None:
                return propagate_through_splat(working.splats, cameras, rows, seeds)
            return propagator.propagate([photos[row] for row in rows], seeds)

        def size(row: int) -> tuple[int, int]:
            width, height = cameras[row].size
            return height, width

        tracked = _track(Segmenter(size, propose, propagate), checkpoint)
    maps = repair_ids(working.splats, cameras, tracked)
    if not any(labels.any() for labels in maps):
        raise StyleSplatError(
            f"{method} has found no object that several photos confirm. Try another model, or draw "
            "boxes with --box."
        )
    return with_label_maps(
        capture, [partial(maps.__getitem__, row) for row in range(len(maps))], {}
    )


def _track(segmenter: Segmenter, checkpoint: MaskCheckpoint) -> list[Labels]:
    """The label maps of all photos, from where an earlier run stopped."""
    maps, state, done = dict[int, Labels](), TrackingState(), 0
    for found, after in checkpoint.load():
        maps, state = maps | found, after
        done += 1
    with task("finding objects", len(checkpoint.clips), unit="clip", done=done) as bar:
        for clip, rows in enumerate(checkpoint.clips[done:], start=done):
            found, state = track_clip(rows, state, segmenter)
            checkpoint.save(clip, found, state)
            maps |= found
            bar.advance()
    return [maps[row] for row in range(len(maps))]
