"""What `mask` has found so far, on disk, so that a run that was interrupted goes on."""

import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path
from stylesplat.io.json_files import read_json, write_json
from stylesplat.io.label_maps import read_label_map, write_label_map
from stylesplat.masks.models.track import State
from stylesplat.progress import say
from stylesplat.scene.labels import Labels, Mask

SETTINGS = "settings.json"
STATE = "state.json"


@dataclass(frozen=True)
class Progress:
    """A folder beside the label maps to be."""

    folder: Path

    def proposals(self, row: int, propose: Callable[[], Sequence[Mask]]) -> list[Mask]:
        """The masks of a photo, from disk if they were found before."""
        path = self.folder / f"proposals_{row}.npz"
        with suppress(OSError, EOFError, ValueError, KeyError, BadZipFile):  # absent or damaged
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                masks = np.unpackbits(stored["bits"], axis=-1, count=int(stored["width"]))
            return [*torch.from_numpy(masks.astype(bool))]
        found = [mask.cpu() for mask in propose()]
        stacked = torch.stack(found).numpy() if found else np.zeros((0, 0, 0), bool)
        with atomic_path(path) as temporary:
            bits = np.packbits(stacked, axis=-1)
            np.savez_compressed(temporary, bits=bits, width=stacked.shape[-1])
        return found

    def save(self, stretches: int, maps: dict[int, Labels], state: State) -> None:
        """Keep the label maps of a stretch, and where tracking stands after it."""
        for row, labels in maps.items():
            write_label_map(labels, self._labels(row))
        if state.known is not None:
            write_label_map(state.known, self._known(stretches))
        missed = {str(id): count for id, count in state.missed.items()}
        stands = {"stretches": stretches, "missed": missed, "next_id": state.next_id}
        write_json(stands, self.folder / STATE)

    def stands(self) -> tuple[int, State]:
        """How many stretches are done, and the state after them; none if that is damaged."""
        if not (self.folder / STATE).exists():
            return 0, State()
        try:
            stands = read_json(self.folder / STATE)
            missed = {int(id): int(count) for id, count in stands["missed"].items()}
            known = read_label_map(self._known(stands["stretches"])).long()
            return int(stands["stretches"]), State(known, missed, int(stands["next_id"]))
        except (StyleSplatError, KeyError, ValueError, TypeError, AttributeError):
            say("What an earlier run left is damaged; tracking begins anew.")
            return 0, State()

    def labels(self, row: int) -> Labels:
        """The label map of a photo whose stretch is done."""
        return read_label_map(self._labels(row)).long()

    def _known(self, stretches: int) -> Path:
        """What was followed into the next key photo, a file for each: a new one may come late."""
        return self.folder / f"known_{stretches}.png"

    def _labels(self, row: int) -> Path:
        return self.folder / f"labels_{row}.png"


def open_progress(folder: Path, settings: dict[str, Any]) -> Progress:
    """Go on where a run with these settings stopped; forget one with others.

    Raises:
        StyleSplatError: If the folder holds something else.
    """
    if folder.exists() and not (folder / SETTINGS).is_file():
        raise StyleSplatError(f"{folder} is in the way of intermediate results. Move it elsewhere.")
    if folder.exists() and not _same(folder / SETTINGS, settings):
        say("An earlier run had other settings, photos or poses; beginning anew.")
        shutil.rmtree(folder)
    elif folder.exists():
        say(f"Continuing from {folder}.")
    write_json(settings, folder / SETTINGS)
    return Progress(folder)


def _same(path: Path, settings: dict[str, Any]) -> bool:
    try:
        return read_json(path) == json.loads(json.dumps(settings))
    except StyleSplatError:  # damaged
        return False
