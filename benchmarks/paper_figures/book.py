"""Results in files: what is there is not computed again."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from bench import machine
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.figures.pictures import to_uint8
from stylesplat.io.images import write_image
from stylesplat.io.json_yaml import read_json, write_json

VERSION = 2  # raise it when the same settings give other numbers

Picture = Float[Tensor, "_ _ 3"] | UInt8[Tensor, "_ _ 3"]


@dataclass(frozen=True)
class Outcome:
    """What a cell found."""

    numbers: Mapping[str, Any]
    """Plain values."""
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    """By what they are called: colours in 0..1 or bytes."""


@dataclass(frozen=True)
class Cell:
    """One of a figure's computations, kept by itself."""

    figure: str
    """Which figure it belongs to."""
    key: str
    """Its name in the figure, which is that of its file."""
    compute: Callable[[], Outcome]
    """Does it."""

    @property
    def name(self) -> tuple[str, str]:
        """What tells it from others."""
        return self.figure, self.key


@dataclass(frozen=True)
class Result:
    """What a cell found, as its files have it."""

    numbers: Mapping[str, Any]
    """Plain values."""
    pictures: Mapping[str, Path]
    """Files by what they are called."""
    seconds: float
    """How long it took."""
    processor_seconds: float
    """The same, of all threads together: what other work beside it does not lengthen."""


Results = Mapping[str, Mapping[str, Result]]
"""By figure and key."""


class Book:
    """The folder of a scene's results."""

    def __init__(self, folder: Path, settings: Mapping[str, Any] | None = None) -> None:
        """Results of other settings are refused, so that no table mixes them.

        Args:
            folder: Where they are, or will be.
            settings: How they are computed; None takes those that are there.
        """
        self.folder, written = folder, folder / "settings.json"
        if not written.is_file():
            if settings is None:
                raise SystemExit(f"{folder} holds no results yet. Compute some first.")
            write_json({"version": VERSION, "machine": machine(), **settings}, written)
        self.settings: Mapping[str, Any] = read_json(written)
        known = {k: v for k, v in self.settings.items() if k != "machine"}
        wanted = known if settings is None else settings
        if known != {**wanted, "version": VERSION}:
            raise SystemExit(
                f"{folder} holds results of other settings ({known}). Choose another folder "
                "with -o, or delete it."
            )

    def has(self, cell: Cell) -> bool:
        """Whether a cell is computed."""
        return self._file(cell.figure, cell.key).is_file()

    def keep(self, cell: Cell) -> None:
        """Compute a cell and write what it found; its numbers last, which say that it is whole."""
        torch.manual_seed(0)
        start, taken = time.perf_counter(), time.process_time()
        outcome = cell.compute()
        spent = {
            "seconds": time.perf_counter() - start,
            "processor_seconds": time.process_time() - taken,
        }
        file, pictures = self._file(cell.figure, cell.key), {}
        for name, picture in outcome.pictures.items():
            place = file.with_name(f"{file.stem}-{_spelled(name)}.png")
            write_image(picture if picture.dtype == torch.uint8 else to_uint8(picture), place)
            pictures[name] = place.name
        write_json({"numbers": outcome.numbers, "pictures": pictures, **spent}, file)

    def results(self, cells: Sequence[Cell]) -> dict[str, dict[str, Result]]:
        """What is computed of some cells."""
        found: dict[str, dict[str, Result]] = {}
        for cell in filter(self.has, cells):
            file = self._file(cell.figure, cell.key)
            said = read_json(file)
            pictures = {name: file.with_name(place) for name, place in said["pictures"].items()}
            result = Result(said["numbers"], pictures, said["seconds"], said["processor_seconds"])
            found.setdefault(cell.figure, {})[cell.key] = result
        return found

    def _file(self, figure: str, key: str) -> Path:
        place = self.folder / figure / f"{_spelled(key)}.json"
        place.parent.mkdir(parents=True, exist_ok=True)
        return place


def work_through(book: Book, cells: Sequence[Cell]) -> Iterator[str]:
    """Compute what is not there, and name each part before."""
    rest = [cell for cell in cells if not book.has(cell)]
    for number, cell in enumerate(rest, start=1):
        yield f"{cell.figure}, {cell.key}: {number} of {len(rest)}"
        book.keep(cell)


def _spelled(key: str) -> str:
    """A key as a file's name; those that differ in signs alone stay apart."""
    plain = "".join(c if c.isalnum() or c in "-." else "-" for c in key)
    return plain if plain == key else f"{plain}-{hashlib.sha256(key.encode()).hexdigest()[:6]}"
