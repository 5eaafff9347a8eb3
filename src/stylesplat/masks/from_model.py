"""`mask --method sam2` and others: label maps of all that a model finds; runs continue."""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.json_yaml import read_json, write_json
from stylesplat.masks.repair import repair_ids
from stylesplat.masks.sam import FAMILIES, SamMethod, load_propagator, load_proposer
from stylesplat.masks.tracking import (
    Segmenter,
    TrackingState,
    propagate_through_splat,
    split_clips,
    track_clip,
)
from stylesplat.masks.working_splat import with_label_maps, working_splat
from stylesplat.progress import say, task
from stylesplat.rendering.render import pick_device
from stylesplat.scene.capture import Capture, Labels, Mask, at_most, fingerprint
from stylesplat.scene.scene import Scene

SETTINGS = "settings.json"


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
            same = read_json(folder / SETTINGS) == json.loads(json.dumps(settings))
        except StyleSplatError:  # damaged, or not yet written
            same = False
        if same:
            say(f"Continuing from {folder}.")
        else:
            say("An earlier run had other settings, photos or poses; beginning anew.")
            shutil.rmtree(folder)
    write_json(settings, folder / SETTINGS)
    return MaskCheckpoint(folder, settings["clips"], settings["sizes"])


def _is_ours(folder: Path) -> bool:
    """Whether a run made it, even if it was killed before it wrote or deleted everything."""
    names = [path.name.lstrip(".") for path in folder.iterdir()] if folder.is_dir() else [""]
    return all(name.startswith(("settings", "clip_")) for name in names)


MODEL_SIZE = 1024  # pixels of the longer side; the models look at no more


@dataclass(frozen=True, eq=False)
class FromModel:
    """Label maps of all objects that a segmentation model finds, under ids that agree in 3D.

    `sam` knows single photos; its masks are propagated from photo to photo by the splat.
    """

    family: SamMethod
    model: str | None = None
    scene: Scene | None = None
    progress: Path | None = None

    def mask(self, capture: Capture, device: str) -> Capture:
        """Find the objects of all photos."""
        family, small, place = self.family, at_most(capture, MODEL_SIZE), pick_device(device)
        proposer, is_video = load_proposer(family, self.model, place), FAMILIES[family].video_types
        propagator = load_propagator(family, self.model, place) if is_video else None
        bare = replace(small, label_maps=None, object_names={})
        settings = {
            "method": family,
            "model": self.model,
            "sizes": small.cameras.sizes.tolist(),
            "photos": fingerprint(bare, photos=len(bare)),
            "clips": split_clips(small.cameras),
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

            tracked = _track(Segmenter(size, propose, propagate), checkpoint)
        maps = repair_ids(working.splats, cameras, tracked)
        if not any(labels.any() for labels in maps):
            raise StyleSplatError(
                f"{self.family} has found no object that several photos confirm. Try another "
                "model, or draw boxes with --box."
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
