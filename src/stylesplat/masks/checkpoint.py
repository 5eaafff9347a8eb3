"""What `mask` has found so far, on disk, so that an interrupted run continues."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.json_files import read_json, write_json
from stylesplat.masks.tracking import TrackingState
from stylesplat.progress import say
from stylesplat.scene.labels import Labels

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
