"""What `mask` has found so far, on disk, so that a run that was interrupted goes on."""

import json
import re
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from zipfile import ZipFile

import msgspec
import numpy as np
import torch
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import MARK, atomic_path
from stylesplat.io.json_files import read_json, read_json_as, write_json
from stylesplat.io.label_maps import read_label_map, write_label_map
from stylesplat.masks.models.track import State
from stylesplat.progress import say
from stylesplat.scene.labels import MAX_ID, Labels, Mask

SETTINGS = "settings.json"
STATE = "state.json"
OURS = re.compile(rf"\.?(settings|state|proposals|known|labels)[_\d]*(\.{MARK})?\.(json|npz|png)")
MAX_PACKED = 2**27  # bytes of a photo's masks: a thousand of 1024x1024

_Id = Annotated[int, Meta(ge=1, le=MAX_ID)]
_IdText = Annotated[str, Meta(pattern=r"\A[0-9]{1,8}\Z")]


class _Stands(msgspec.Struct):
    """Where tracking stands."""

    stretches: Annotated[int, Meta(ge=1, le=10**6)]
    missed: dict[_IdText, Annotated[int, Meta(ge=0, le=10**6)]]
    next_id: _Id


@dataclass(frozen=True)
class Progress:
    """A folder beside the label maps to be."""

    folder: Path
    sizes: Sequence[Sequence[int]] = ()
    """Width and height of each photo; empty if nobody knows them."""

    def proposals(self, row: int, propose: Callable[[], Sequence[Mask]]) -> list[Mask]:
        """The masks of a photo, from disk if they were found before."""
        path = self.folder / f"proposals_{row}.npz"
        with suppress(Exception):  # absent or damaged: NumPy and zipfile raise a dozen kinds
            masks = _unpacked(path)
            if self._fits(row, masks):
                return masks
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
            stands = read_json_as(self.folder / STATE, _Stands, "")
            known = read_label_map(self._known(stands.stretches)).long()
            missed = {int(id): count for id, count in stands.missed.items()}
            return stands.stretches, State(known, missed, stands.next_id)
        except StyleSplatError:
            say("What an earlier run left is damaged; tracking begins anew.")
            return 0, State()

    def labels(self, row: int) -> Labels:
        """The label map of a photo whose stretch is done.

        Raises:
            StyleSplatError: If it is damaged.
        """
        labels = read_label_map(self._labels(row)).long()
        if not self._fits(row, [labels]):
            raise StyleSplatError(
                f"{self._labels(row)} is of another size than its photo. Delete {self.folder}, and "
                "run again."
            )
        return labels

    def _fits(self, row: int, pictures: Sequence[Tensor]) -> bool:
        """Whether pictures have the size of a photo, as far as that is known."""
        if not self.sizes:
            return True
        width, height = self.sizes[row]
        return all(picture.shape == (height, width) for picture in pictures)

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
    if folder.exists() and not _is_ours(folder):
        raise StyleSplatError(f"{folder} is in the way of intermediate results. Move it elsewhere.")
    if folder.exists() and not _same(folder / SETTINGS, settings):
        say("An earlier run had other settings, photos or poses; beginning anew.")
        shutil.rmtree(folder)
    elif folder.exists():
        say(f"Continuing from {folder}.")
    write_json(settings, folder / SETTINGS)
    return Progress(folder, settings.get("sizes", ()))


def _unpacked(path: Path) -> list[Mask]:
    """The masks in a file; raises anything if they are none, or more than a photo can have."""
    if not path.is_file():
        raise ValueError("no plain file")
    with ZipFile(path) as packed:
        if sum(each.file_size for each in packed.infolist()) > MAX_PACKED:
            raise ValueError("more than a photo can have")
    with np.load(path, allow_pickle=False) as stored:
        bits, width = stored["bits"], int(stored["width"])
    if bits.ndim != 3 or bits.dtype != np.uint8 or -(-width // 8) != bits.shape[2]:
        raise ValueError("no masks")
    return [*torch.from_numpy(np.unpackbits(bits, axis=-1, count=width).astype(bool))]


def _is_ours(folder: Path) -> bool:
    """Whether a run made it, and be it that it was killed before it wrote or deleted all."""
    if not folder.is_dir():
        return False
    return (folder / SETTINGS).is_file() or all(OURS.fullmatch(p.name) for p in folder.iterdir())


def _same(path: Path, settings: dict[str, Any]) -> bool:
    try:
        return read_json(path) == json.loads(json.dumps(settings))
    except StyleSplatError:  # damaged
        return False
