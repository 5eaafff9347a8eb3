"""Damaged and hostile files, made from valid ones; the same seed makes the same file.

A mutant is `mutant(name, content, seed)`: the file's name says its format, and so what is done to
it. Half of them are damaged as bytes, where the format has a structure to be damaged too.
"""

import random
import struct
from collections.abc import Callable
from pathlib import PurePath

import json_mutants
import picture_mutants
import table_mutants
import tensor_mutants

Mutator = Callable[[bytes, random.Random], bytes]

INTEGERS = (0, 1, -1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, -(2**63), 10**6)
RUN = 64  # bytes at most that are inserted, doubled or overwritten


def mutant(name: str, content: bytes, seed: int) -> bytes:
    """A file as somebody careless or hostile could have made it.

    Args:
        name: What it is called: by its suffix, and COCO's by its stem, the mutator is chosen.
        content: Of a valid file of that kind.
        seed: Which one.
    """
    random_ = random.Random(f"{name}:{seed}")
    structural = mutators(name)
    if not structural or random_.random() < BYTEWISE.get(PurePath(name).suffix, 0.5):
        return bytes_mutant(content, random_)
    return random_.choice(structural)(content, random_)


def mutators(name: str) -> tuple[Mutator, ...]:
    """What knows the structure of a file of that name."""
    path = PurePath(name)
    if path.suffix == ".json" and path.stem.startswith("coco"):
        return (json_mutants.coco_mutant, json_mutants.json_mutant)
    if path.suffix == ".bin":
        return (table_mutants.counts_mutant,)
    return STRUCTURAL.get(path.suffix.lower(), ())


def bytes_mutant(content: bytes, random_: random.Random) -> bytes:
    """One to four blind changes of a file's bytes."""
    for _ in range(random_.choice((1, 1, 2, 4))):
        content = random_.choice(BLIND)(content, random_)
    return content


def flip(content: bytes, random_: random.Random) -> bytes:
    """Change a few bits."""
    changed = bytearray(content)
    for _ in range(random_.choice((1, 3, 20))):
        if changed:
            changed[_place(changed, random_)] ^= 1 << random_.randrange(8)
    return bytes(changed)


def truncate(content: bytes, random_: random.Random) -> bytes:
    return content[: random_.randrange(len(content) + 1)]


def insert(content: bytes, random_: random.Random) -> bytes:
    place = _place(content, random_)
    return content[:place] + random_.randbytes(random_.randrange(1, RUN)) + content[place:]


def duplicate(content: bytes, random_: random.Random) -> bytes:
    place = _place(content, random_)
    length = random_.choice((1, 8, RUN, len(content)))
    return content[: place + length] + content[place:]


def remove(content: bytes, random_: random.Random) -> bytes:
    place = _place(content, random_)
    return content[:place] + content[place + random_.randrange(1, RUN) :]


def run(content: bytes, random_: random.Random) -> bytes:
    """Overwrite with one value."""
    place, length = _place(content, random_), random_.randrange(1, RUN)
    value = random_.choice((b"\0", b"\xff", b" ", b"["))
    return content[:place] + value * length + content[place + length :]


def integer(content: bytes, random_: random.Random) -> bytes:
    """Put an extreme number somewhere, as 32 or 64 bits."""
    size, kind = random_.choice(((4, "<I"), (8, "<Q"), (2, "<H")))
    value = random_.choice(INTEGERS) % 2 ** (8 * size)
    place = _place(content, random_)
    return content[:place] + struct.pack(kind, value) + content[place + size :]


def _place(content: bytes | bytearray, random_: random.Random) -> int:
    """Anywhere; half of the time in the first bytes, where headers are."""
    end = min(len(content), 200) if random_.random() < 0.5 else len(content)
    return random_.randrange(max(1, end))


BLIND: tuple[Mutator, ...] = (flip, flip, truncate, insert, duplicate, remove, run, integer)
BYTEWISE = {
    ".json": 0.1,
    ".yaml": 0.1,
    ".safetensors": 0.3,
    ".pt": 0.2,
    ".txt": 0.3,
    ".ply": 0.3,
    ".glb": 0.2,
    ".gltf": 0.1,
}
"""The share of mutants that are blind changes; by default half."""
STRUCTURAL: dict[str, tuple[Mutator, ...]] = {
    ".json": (json_mutants.json_mutant,),
    ".yaml": (json_mutants.yaml_mutant,),
    ".safetensors": (tensor_mutants.safetensors_mutant,),
    ".pt": (tensor_mutants.checkpoint_mutant,),
    ".ply": (table_mutants.ply_mutant,),
    ".txt": (table_mutants.text_mutant,),
    ".glb": (table_mutants.glb_mutant,),
    ".gltf": (json_mutants.json_mutant,),
    ".png": (picture_mutants.png_size_mutant,),
    ".jpg": (picture_mutants.jpeg_size_mutant,),
    ".tif": (picture_mutants.tiff_tag_mutant,),
    ".webp": (picture_mutants.webp_size_mutant,),
}
