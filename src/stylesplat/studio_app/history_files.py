"""The history of a studio on disk: it goes on where it was, also after a studio that was killed.

`studio-history` in the scene's folder has `history.json`, which is replaced as a whole, and the
files that its states share: layers, masks and pictures, each named by the digest of its content.
"""

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import replace
from hashlib import blake2b
from itertools import count
from pathlib import Path
from typing import Annotated, Any, Literal
from weakref import WeakKeyDictionary, WeakValueDictionary
from zlib import compress, decompressobj, error

import msgspec
import numpy as np
import torch
from jaxtyping import UInt8
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import refuse_unwritable, write_file
from stylesplat.io.files import read_bytes
from stylesplat.io.json_yaml import read_json_as, strict_json
from stylesplat.io.layers import (
    LAYER_PLAIN,
    LayerRecord,
    layer_identity,
    layer_record,
    layer_tensors,
    read_layer,
    write_layer,
)
from stylesplat.progress import say
from stylesplat.scene.layers import Layer
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.history import CompactState, Selected, Step, StudioState
from stylesplat.studio_app.session import Session

HISTORY, HISTORY_INDEX = "studio-history", "history.json"
MOST_HISTORY_BYTES = 2 * 2**30  # of the files of a history: the oldest steps make room
NEAR = 10  # steps from the present one that stay in memory
SAMPLED = 10_000  # Gaussians of a base whose values tell it from others

Digest = Annotated[str, Meta(pattern=r"\A[0-9a-f]{32}\Z")]


class _Object(msgspec.Struct):
    mask: Digest
    selection: Selection


class _Selected(msgspec.Struct):
    weights: Digest
    record: Selection
    origin: str


class _Record(msgspec.Struct):
    """A step."""

    number: Annotated[int, Meta(ge=1)]
    note: str
    layers: list[LayerRecord]
    objects: dict[str, _Object]
    metrics: dict[str, Any]
    picked: tuple[str, ...]
    hidden: frozenset[str]
    locked: frozenset[str]
    solo: tuple[str, dict[str, bool]] | None
    selection: _Selected | None
    picture: Digest | None = None

    @property
    def content(self) -> str:
        """Equal for two states of the same scene."""
        objects = {
            name: (each.mask, msgspec.structs.asdict(each.selection))  # defaults as well
            for name, each in self.objects.items()
        }
        return content_digest(msgspec.json.encode((self.layers, objects), order="deterministic"))

    def files(self) -> set[str]:
        """The names of its files."""
        masks = [each.mask for each in self.objects.values()]
        masks += [] if self.selection is None else [self.selection.weights]
        pictures = {f"{self.picture}.jpg"} if self.picture else set[str]()
        return pictures | {each.file for each in self.layers} | {f"{each}.mask" for each in masks}


class _Index(msgspec.Struct):
    version: Literal[1]
    base: Digest
    saved: Digest
    """The content of the scene that was saved, or opened."""
    now: int
    steps: Annotated[list[_Record], Meta(min_length=1)]
    snapshots: list[_Record]


class HistoryFolder:
    def __init__(self, session: Session) -> None:
        self._session = session
        self._base = _base_digest(session.state.scene.base)
        self._records = WeakKeyDictionary[Step, _Record]()
        self._digests = dict[tuple[int, ...], tuple[Layer | Tensor, str]]()
        """Of layers and masks in memory, by their identities."""
        self._scenes = WeakValueDictionary[str, Scene]()
        self._written = self._tried = self._key()
        self._stamp = _stamp(self._folder / HISTORY_INDEX)
        session.history.read = self._read

    @property
    def _folder(self) -> Path:
        return self._session.folder / HISTORY

    @property
    def is_behind(self) -> bool:
        """Whether there is something that the folder does not hold, and that was not tried yet."""
        return self._key() not in (self._written, self._tried)

    def _key(self) -> object:
        history = self._session.history
        return history.row, [(e, e.picture) for e in (*history.steps, *history.snapshots)]

    def resume(self) -> None:
        """Go on with the history that the folder holds, if it is of this scene."""
        session, index = self._session, self._read_index()
        if index is None:
            return
        opened = self._record_of(session.history.step_now)
        self._scenes[opened.content] = session.saved.scene
        steps, snapshots = (self._steps(each) for each in (index.steps, index.snapshots))
        row = next((n for n, each in enumerate(steps) if each.number == index.now), None)
        known = {index.saved, *(self._records[each].content for each in steps)}
        if row is not None and opened.content in known:
            try:
                session.history.go_on_with(steps, row, snapshots)
            except StyleSplatError as failure:
                say(f"A step of the history is lost. {failure}")
            else:
                self._written = self._key()
                if session.unsaved:
                    say("Recovered what was not saved. The history goes back to what was.")
                return
        # Another program has changed the scene, or the present step is lost
        steps = steps[: len(steps) if row is None else row + 1]
        number = 1 + max(each.number for each in (*index.steps, *index.snapshots))
        last = Step(number, "Opened", CompactState(session.state))
        session.history.go_on_with([*steps, last], len(steps), snapshots)

    def write(self) -> bool:
        """Write what the folder lacks, in the worker's thread; returns whether all is saved.

        Raises:
            StyleSplatError: If it cannot be written, or another studio has written it.
        """
        session, history, folder = self._session, self._session.history, self._folder
        self._tried = self._key()
        if self._tried == self._written:
            return not session.unsaved
        refuse_unwritable(session.folder)
        if _stamp(folder / HISTORY_INDEX) != self._stamp:
            raise StyleSplatError(
                f"Another studio has written {folder}. Close one of the two; until then the "
                "history of this one is not kept."
            )
        for step in (*history.steps, *history.snapshots):
            if step.kept is not None:
                record = self._records[step] = self._record_of(step)
                self._write_files(step.kept.bare, step.picture, record)
                if step.kept.scene is not None:
                    self._scenes.setdefault(record.content, step.kept.scene)
        self._bound()
        steps, snapshots = (
            [self._records[each] for each in own] for own in (history.steps, history.snapshots)
        )
        saved = self._record_of(Step(1, "", CompactState(session.saved))).content
        now = history.step_now.number
        index = _Index(1, self._base, saved, now, steps, snapshots)
        write_file(folder / HISTORY_INDEX, msgspec.json.encode(index))
        self._stamp, self._written = _stamp(folder / HISTORY_INDEX), self._key()
        self._sweep([*steps, *snapshots])
        self._release()
        return not session.unsaved

    def move_along(self, before: Path) -> None:
        """Move it from the folder before into the session's, which is another one by now."""
        if (before / HISTORY).is_dir():
            shutil.move(before / HISTORY, self._folder)

    def _read_index(self) -> _Index | None:
        path = self._folder / HISTORY_INDEX
        if not path.exists():
            return None
        try:
            index = read_json_as(path, _Index, "A new history begins.")
            if index.base == self._base:
                return index
            fault = f"{path} belongs to other Gaussians. A new history begins."
        except StyleSplatError as failure:
            fault = str(failure)
        names = (f"{HISTORY}.{n}" for n in count(1))
        aside = next(p for p in map(self._session.folder.__truediv__, names) if not p.exists())
        try:
            self._folder.rename(aside)
            fault += f" The old one is now {aside}."
            self._stamp = None
        except OSError:  # then nothing can be written, either
            pass
        say(fault)
        return None

    def _steps(self, records: Sequence[_Record]) -> list[Step]:
        """The steps of records, as far as their files are there."""
        steps = list[Step]()
        for record in records:
            missing = [name for name in record.files() if not self._path(name).is_file()]
            if missing:
                say(f"{record.note} is left out of the history: {missing[0]} is missing.")
                continue
            picture = self._path(f"{record.picture}.jpg").read_bytes() if record.picture else b""
            step = Step(record.number, record.note, None, picture)
            self._records[step] = record
            steps.append(step)
        return steps

    def _read(self, step: Step) -> StudioState:
        """Read a state.

        Raises:
            StyleSplatError: If a file is damaged or missing.
        """
        record, now = self._records[step], self._session.state.scene
        scene = self._scenes.get(record.content)
        if scene is None:
            layers = tuple(self._layer(each, len(now.base)) for each in record.layers)
            objects = {
                name: SceneObject(self._mask(each.mask) >= 128, each.selection)
                for name, each in record.objects.items()
            }
            parts: dict[str, Any] = {"layers": layers, "objects": objects}
            scene = replace(now, **parts, metrics=record.metrics, path=None, composed=None)
            self._scenes[record.content] = scene
        selected, selection = record.selection, None
        if selected is not None:
            weights = self._mask(selected.weights)
            selection = Selected(weights, selected.record, selected.origin)
        own = {n: getattr(record, n) for n in ("picked", "hidden", "locked", "solo", "note")}
        return StudioState(scene, selection=selection, **own)

    def _layer(self, record: LayerRecord, base: int) -> Layer:
        """Read a layer, or take the tensors of one in memory that has the same."""
        known = (each for each, file in self._digests.values() if file == record.file)
        layer = next(known, None)
        if isinstance(layer, Layer):
            return replace(layer, **{name: getattr(record, name) for name in LAYER_PLAIN})
        layer = read_layer(self._folder / "layers", record, base)
        self._digests[layer_identity(layer)] = layer, record.file
        return layer

    def _mask(self, digest: str) -> UInt8[Tensor, " B"]:
        path, length = self._path(f"{digest}.mask"), len(self._session.state.scene.base)
        try:
            content = decompressobj().decompress(read_bytes(path), length + 1)
        except error as failure:
            raise StyleSplatError(f"Cannot read {path}: {failure}. Choose another step.") from None
        if len(content) != length:
            raise StyleSplatError(f"Cannot read {path}: it is incomplete. Choose another step.")
        return torch.from_numpy(np.frombuffer(content, np.uint8).copy())

    def _record_of(self, step: Step) -> _Record:
        if step in self._records:
            record = self._records[step]
            picture = content_digest(step.picture) if step.picture else None
            return msgspec.structs.replace(record, picture=picture)
        assert step.kept is not None  # what is on the disk alone has a record
        state = step.kept.bare
        selection = state.selection
        files = [self._layer_file(each) for each in state.scene.layers]
        pairs = zip(state.scene.layers, files, strict=True)
        layers = [layer_record(layer, file) for layer, file in pairs]
        plain = msgspec.json.decode(strict_json({"a": layers, "b": state.scene.metrics}))
        return _Record(
            step.number,
            step.note,
            layers=msgspec.convert(plain["a"], list[LayerRecord]),
            objects={
                name: _Object(self._mask_digest(each.mask), each.selection)
                for name, each in state.scene.objects.items()
            },
            metrics=plain["b"],
            picked=state.picked,
            hidden=state.hidden,
            locked=state.locked,
            solo=None if state.solo is None else (state.solo[0], dict(state.solo[1])),
            selection=selection
            and _Selected(self._mask_digest(selection.weights), selection.record, selection.origin),
            picture=content_digest(step.picture) if step.picture else None,
        )

    def _write_files(self, state: StudioState, picture: bytes, record: _Record) -> None:
        """Write the files of a state that are not there yet."""
        for layer, own in zip(state.scene.layers, record.layers, strict=True):
            if not self._path(own.file).exists():
                write_layer(layer, self._path(own.file))
        masks = [each.mask for each in state.scene.objects.values()]
        masks += [] if state.selection is None else [state.selection.weights]
        for mask in masks:
            name = f"{self._mask_digest(mask)}.mask"
            self._write(name, lambda mask=mask: compress(_mask_bytes(mask), 1))
        if picture:
            self._write(f"{record.picture}.jpg", lambda: picture)

    def _write(self, name: str, content: Any) -> None:
        path = self._path(name)
        if not path.exists():
            write_file(path, content())

    def _path(self, name: str) -> Path:
        kinds = {".safetensors": "layers", ".mask": "masks", ".jpg": "pictures"}
        return self._folder / kinds[Path(name).suffix] / name

    def _layer_file(self, layer: Layer) -> str:
        key = layer_identity(layer)
        if key not in self._digests:
            tensors = layer_tensors(layer).values()
            content = (tensor_bytes(tensor) for tensor in tensors)
            self._digests[key] = layer, f"00-{content_digest(*content)}.safetensors"
        return self._digests[key][1]

    def _mask_digest(self, mask: Tensor) -> str:
        key = (id(mask),)
        if key not in self._digests:
            self._digests[key] = mask, content_digest(_mask_bytes(mask))
        return self._digests[key][1]

    def _bound(self) -> None:
        """Drop the oldest steps, as long as the files of all take too many bytes."""
        history, sizes = self._session.history, dict[str, int]()
        for place, step in reversed([*enumerate(history.steps)]):
            for name in self._records[step].files():
                sizes.setdefault(name, self._path(name).stat().st_size)
            if sum(sizes.values()) > MOST_HISTORY_BYTES:
                history.drop_oldest(place + 1)
                return

    def _sweep(self, records: Iterable[_Record]) -> None:
        """Delete the files that no step has any more."""
        wanted = {name for record in records for name in record.files()}
        for path in self._folder.glob("*/*"):
            if path.name not in wanted:
                path.unlink(missing_ok=True)

    def _release(self) -> None:
        """Forget the states far from the present one, which are on the disk."""
        history = self._session.history
        for place, step in enumerate(history.steps):
            if abs(place - history.row) > NEAR:
                step.kept = None
        for step in history.snapshots:
            step.kept = None
        kept = [each.kept.bare for each in history.steps if each.kept is not None]
        alive = {layer_identity(layer) for state in kept for layer in state.scene.layers}
        alive |= {(id(each.mask),) for state in kept for each in state.scene.objects.values()}
        alive |= {(id(each.selection.weights),) for each in kept if each.selection is not None}
        self._digests = {key: own for key, own in self._digests.items() if key in alive}


def content_digest(*contents: bytes | memoryview) -> str:
    """What names a file, or tells one layer from others."""
    found = blake2b(digest_size=16)
    for content in contents:
        found.update(content)
    return found.hexdigest()


def tensor_bytes(tensor: Tensor) -> memoryview:
    return tensor.detach().cpu().contiguous().numpy().reshape(-1).view(np.uint8).data


def _mask_bytes(mask: Tensor) -> bytes:
    """A mask, or weights in 255ths, as bytes."""
    rows = mask.detach().cpu()
    return (rows if rows.dtype == torch.uint8 else 255 * rows.byte()).numpy().tobytes()


def _base_digest(base: Splats) -> str:
    """What tells a base from others, of some of its rows."""
    rows = torch.linspace(0, len(base) - 1, min(len(base), SAMPLED)).long().to(base.device)
    parts = (tensor_bytes(each[rows]) for each in (base.means, base.sh0, base.opacities))
    return content_digest(str(len(base)).encode(), *parts)


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
