"""`mask --method sam2` and others: label maps of all that a model finds; runs continue."""

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from stylesplat.errors import StyleSplatError, format_duration
from stylesplat.io.atomic import atomic_path
from stylesplat.io.json_yaml import read_json, write_json
from stylesplat.masks.repair import repair_ids
from stylesplat.masks.sam import FAMILIES, SamMethod, load_propagator, load_proposer
from stylesplat.masks.tracking import (
    Segmenter,
    TrackingState,
    lift_and_render,
    masks_to_labels,
    propagate_through_splat,
    separate_masks,
    split_clips,
    track_clip,
)
from stylesplat.masks.working_splat import with_label_maps, working_splat
from stylesplat.progress import say, task, track
from stylesplat.rendering.render import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, Labels, Mask, at_most, fingerprint
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import farthest_views

SETTINGS_FILE = "settings.json"


@dataclass(frozen=True)
class MaskCheckpoint:
    """A folder with one file for each clip that is done."""

    folder: Path
    clips: list[list[int]]
    """The rows of the photos of each clip."""
    sizes: list[list[int]]
    """Width and height of each photo."""

    def save(self, clip: int, maps: dict[int, Labels], state: TrackingState) -> None:
        """Write the label maps of a clip, and the state of tracking after it."""
        arrays = {f"labels_{row}": labels.int().numpy() for row, labels in maps.items()}
        arrays["missed"] = np.array([*state.missed.items()], np.int64).reshape(-1, 2)
        arrays["next_id"] = np.array(state.next_id)
        with atomic_path(self._file(clip)) as draft, draft.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    def load(self) -> Iterator[tuple[dict[int, Labels], TrackingState]]:
        """What an earlier run saved, clip by clip, up to the first file that is damaged."""
        for clip, rows in enumerate(self.clips):
            if not self._file(clip).exists():
                return
            try:
                with (
                    self._file(clip).open("rb") as file,
                    np.load(file, allow_pickle=False) as stored,
                ):
                    found = {row: torch.from_numpy(stored[f"labels_{row}"]).long() for row in rows}
                    missed = {int(id): int(count) for id, count in stored["missed"]}
                    next_id = int(stored["next_id"])
                assert all([*found[row].shape[::-1]] == self.sizes[row] for row in rows)
            except Exception:  # NumPy and zipfile raise a dozen kinds
                say("What an earlier run left is damaged; objects are found again from there.")
                return
            yield found, TrackingState(found[rows[-1]], missed, next_id)

    def _file(self, clip: int) -> Path:
        return self.folder / f"clip_{clip}.npz"


def open_checkpoint(folder: Path, settings: dict[str, Any]) -> MaskCheckpoint:
    """Continue an earlier run with these settings; delete the results of one with others."""
    if folder.exists():
        if not _is_ours(folder):
            raise StyleSplatError(
                f"{folder} is in the way of intermediate results. Move it elsewhere."
            )
        try:
            same = read_json(folder / SETTINGS_FILE) == json.loads(json.dumps(settings))
        except StyleSplatError:  # damaged, or not yet written
            same = False
        if same:
            say(f"Continuing from {folder}.")
        else:
            say("An earlier run had other settings, photos or poses; beginning anew.")
            shutil.rmtree(folder)
    write_json(settings, folder / SETTINGS_FILE)
    return MaskCheckpoint(folder, settings["clips"], settings["sizes"])


def _is_ours(folder: Path) -> bool:
    """Whether a run made it, even if it was killed before it wrote or deleted everything."""
    names = [path.name.lstrip(".") for path in folder.iterdir()] if folder.is_dir() else [""]
    return all(name.startswith(("settings", "clip_")) for name in names)


MODEL_SIZE = 1024  # pixels of the longer side; the models look at no more
# On a CPU the model is asked about one photo in so many, but at least about as many as show every
# side of an object on an orbit twice
ASKED_SHARE, ASKED_LEAST = 4, 16


@dataclass(frozen=True, eq=False)
class FromModel:
    """Label maps of all objects that a segmentation model finds, under ids that agree in 3D.

    On a GPU the objects are followed from photo to photo, by the model or, as `sam` knows single
    photos, by the splat. On a CPU the model is asked about some photos from all sides, and the
    splat carries what it finds to the others.
    """

    family: SamMethod
    model: str | None = None
    scene: Scene | None = None
    progress: Path | None = None

    def mask(self, capture: Capture, device: str) -> Capture:
        """Find the objects of all photos."""
        family, small, place = self.family, at_most(capture, MODEL_SIZE), pick_device(device)
        on_cpu, is_video = place.type == "cpu", FAMILIES[family].video_types
        clips = self._asked(small.cameras) if on_cpu else split_clips(small.cameras)
        proposer = load_proposer(family, self.model, place)
        propagator = load_propagator(family, self.model, place) if is_video and not on_cpu else None
        bare = replace(small, label_maps=None, object_names={})
        settings = {
            "method": family,
            "model": self.model,
            "sizes": small.cameras.sizes.tolist(),
            "photos": fingerprint(bare, photos=len(bare)),
            "clips": clips,
        }
        with TemporaryDirectory() as temporary:
            checkpoint = open_checkpoint(self.progress or Path(temporary) / "progress", settings)
            working = working_splat(small, self.scene, device)
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

            segmenter = Segmenter(size, propose, propagate)
            found = _find(label_photo if on_cpu else track_clip, segmenter, checkpoint)
        rows = sorted(found)
        repaired = repair_ids(working.splats, cameras[rows], [found[row] for row in rows])
        maps = dict(zip(rows, repaired, strict=True))
        if not any(labels.any() for labels in repaired):
            raise StyleSplatError(
                f"{family} has found no object that several photos confirm. Try another "
                "model, or draw boxes with --box."
            )
        others = [row for row in range(len(cameras)) if row not in maps]
        rendered = lift_and_render(working.splats, cameras, maps, others)
        if others:
            rendered = track(rendered, "objects in other photos", unit="photo", total=len(others))
        maps |= dict(zip(others, rendered, strict=True))
        return with_label_maps(
            capture, [partial(maps.__getitem__, row) for row in range(len(maps))], {}
        )

    def _asked(self, cameras: Cameras) -> list[list[int]]:
        """The photos that the model is asked about on a CPU, each a clip of its own."""
        count = min(max(ASKED_LEAST, -(-len(cameras) // ASKED_SHARE)), len(cameras))
        seconds = count * FAMILIES[self.family].core_seconds / torch.get_num_threads()
        about = f"about {format_duration(seconds)}"
        duration = (
            f" in {about}" if self.model is None else f", which takes its usual model {about}"
        )
        say(
            f"On a CPU {self.family} is asked about {count} of {len(cameras)} photos{duration}; "
            "a splat carries what it finds to the others. On a GPU it follows objects through all."
        )
        return [[row] for row in sorted(farthest_views(cameras, count))]


def label_photo(
    rows: Sequence[int], state: TrackingState, segmenter: Segmenter
) -> tuple[dict[int, Labels], TrackingState]:
    """Label a clip of one photo by what is detected there, under ids of its own."""
    (row,) = rows
    masks = dict(enumerate(separate_masks(segmenter.propose(row)), start=1))
    return {row: masks_to_labels(masks, segmenter.size(row))}, state


def _find(
    label_clip: Callable[
        [Sequence[int], TrackingState, Segmenter], tuple[dict[int, Labels], TrackingState]
    ],
    segmenter: Segmenter,
    checkpoint: MaskCheckpoint,
) -> dict[int, Labels]:
    """The label maps by photo, from where an earlier run stopped."""
    maps, state, done = dict[int, Labels](), TrackingState(), 0
    for found, after in checkpoint.load():
        maps, state = maps | found, after
        done += 1
    with task("finding objects", len(checkpoint.clips), unit="clip", done=done) as bar:
        for clip, rows in enumerate(checkpoint.clips[done:], start=done):
            found, state = label_clip(rows, state, segmenter)
            checkpoint.save(clip, found, state)
            maps |= found
            bar.advance()
    return maps
