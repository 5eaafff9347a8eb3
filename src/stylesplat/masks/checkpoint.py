"""What `mask` has found so far, on disk, so that an interrupted run continues."""

import json
import re
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import torch
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import MARK, atomic_path
from stylesplat.io.json_files import read_json, read_json_as, write_json
from stylesplat.io.label_maps import read_label_map, write_label_map
from stylesplat.masks.tracking import TrackingState
from stylesplat.progress import say
from stylesplat.scene.labels import MAX_ID, Labels, Mask

SETTINGS = "settings.json"
STATE = "state.json"
OURS = re.compile(rf"\.?(settings|state|proposals|known|labels)[_\d]*(\.{MARK})?\.(json|npz|png)")

_IdText = Annotated[str, Meta(pattern=r"\A[0-9]{1,8}\Z")]


class _StateFile(msgspec.Struct):
    clips: Annotated[int, Meta(ge=1, le=10**6)]
    missed: dict[_IdText, Annotated[int, Meta(ge=0, le=10**6)]]
    next_id: Annotated[int, Meta(ge=1, le=MAX_ID)]


@dataclass(frozen=True)
class MaskCheckpoint:
    """A folder of intermediate results, beside the label maps."""

    folder: Path
    sizes: Sequence[Sequence[int]] = ()
    """Width and height of each photo; empty if they are not known."""

    def proposals(self, row: int, propose: Callable[[], Sequence[Mask]]) -> list[Mask]:
        """The proposed masks of a photo, from disk if they were found before."""
        path = self.folder / f"proposals_{row}.npz"
        with suppress(Exception):  # absent or damaged: NumPy and zipfile raise a dozen kinds
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                bits, width = stored["bits"], int(stored["width"])
            assert bits.ndim == 3 and -(-width // 8) == bits.shape[2]
            masks = [*torch.from_numpy(np.unpackbits(bits, axis=-1, count=width).astype(bool))]
            if self._fits(row, masks):
                return masks
        found = [mask.cpu() for mask in propose()]
        stacked = torch.stack(found).numpy() if found else np.zeros((0, 0, 0), bool)
        with atomic_path(path) as temporary:
            bits = np.packbits(stacked, axis=-1)
            np.savez_compressed(temporary, bits=bits, width=stacked.shape[-1])
        return found

    def save(self, clips: int, maps: dict[int, Labels], state: TrackingState) -> None:
        """Write the label maps of a clip, and the state of tracking after it."""
        for row, labels in maps.items():
            write_label_map(labels, self._labels(row))
        if state.known is not None:
            write_label_map(state.known, self._known(clips))
        missed = {str(id): count for id, count in state.missed.items()}
        content = {"clips": clips, "missed": missed, "next_id": state.next_id}
        write_json(content, self.folder / STATE)

    def load(self) -> tuple[int, TrackingState]:
        """How many clips are done, and the state after them; none if that is damaged."""
        if not (self.folder / STATE).exists():
            return 0, TrackingState()
        try:
            content = read_json_as(self.folder / STATE, _StateFile, "")
            known = read_label_map(self._known(content.clips)).long()
        except StyleSplatError:
            say("What an earlier run left is damaged; tracking begins anew.")
            return 0, TrackingState()
        missed = {int(id): count for id, count in content.missed.items()}
        return content.clips, TrackingState(known, missed, content.next_id)

    def labels(self, row: int) -> Labels:
        """The label map of a photo whose clip is done."""
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

    def _known(self, clips: int) -> Path:
        """A file for each clip, so that it never differs from the state that names it."""
        return self.folder / f"known_{clips}.png"

    def _labels(self, row: int) -> Path:
        return self.folder / f"labels_{row}.png"


def open_checkpoint(folder: Path, settings: dict[str, Any]) -> MaskCheckpoint:
    """Continue an earlier run with these settings; delete the results of one with others."""
    if folder.exists() and not _is_ours(folder):
        raise StyleSplatError(f"{folder} is in the way of intermediate results. Move it elsewhere.")
    if folder.exists():
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
    return MaskCheckpoint(folder, settings.get("sizes", ()))


def _is_ours(folder: Path) -> bool:
    """Whether a run made it, even if it was killed before it wrote or deleted everything."""
    if not folder.is_dir():
        return False
    return (folder / SETTINGS).is_file() or all(OURS.fullmatch(p.name) for p in folder.iterdir())
