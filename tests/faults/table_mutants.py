"""PLY, GLB, COLMAP's binary files and its texts, with other headers, counts and numbers."""

import random
import struct

import json_mutants

NUMBERS = ("nan", "inf", "-inf", "1e38", "-1e308", "0", "-1", "x", "", "1e400", "9" * 400, "0x10")
WORDS = (*NUMBERS, "4294967295", "9223372036854775807", "-9223372036854775808", "../../x.png", "é")
FLOATS = (float("nan"), float("inf"), float("-inf"), 1e38, -1e38, 3e38, 1e-45, 0.0, 1e5)
PROPERTIES = ("property float x", "property double x", "property uchar opacity", "comment \0")
HEADER_END = b"end_header\n"


def ply_mutant(content: bytes, random_: random.Random) -> bytes:
    """Another header, or numbers that no Gaussian has."""
    head, end, body = content.partition(HEADER_END)
    if random_.random() < 0.5:
        return head + end + _floats(body, random_)
    lines = head.decode("latin-1").splitlines()
    row = random_.randrange(len(lines))
    changes = (
        lines[:row] + lines[row + 1 :],
        [*lines[: row + 1], *lines[row:]],
        [*lines[:row], random_.choice(PROPERTIES), *lines[row:]],
        [*lines[:row], _words(lines[row], random_), *lines[row + 1 :]],
        random_.sample(lines, len(lines)),
        [line if "element" not in line else _words(line, random_) for line in lines],
    )
    return "\n".join([*random_.choice(changes), ""]).encode("utf-8") + end + body


def glb_mutant(content: bytes, random_: random.Random) -> bytes:
    """Another JSON in chunks that fit, or numbers that no Gaussian has."""
    (size,) = struct.unpack_from("<I", content, 12)
    text, rest = content[20 : 20 + size], content[20 + size :]
    if random_.random() < 0.3:
        rest = rest[:8] + _floats(rest[8:], random_)
    else:
        text = json_mutants.json_mutant(text, random_)
        text += b" " * (-len(text) % 4)
    head = content[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text))
    return head + content[16:20] + text + rest


def counts_mutant(content: bytes, random_: random.Random) -> bytes:
    """COLMAP's binary files with another number of records, or of a record's parts."""
    offset = 0 if random_.random() < 0.4 else random_.randrange(max(1, len(content) - 8))
    number = random_.choice((0, 1, 2, 5, 2**20, 2**31, 2**32, 2**61, 2**63, 2**64 - 1))
    kind = random_.choice(("<Q", "<I", "<d"))
    if kind == "<d":
        packed = struct.pack(kind, random_.choice(FLOATS))
    else:
        packed = struct.pack(kind, number % 2 ** (64 if kind == "<Q" else 32))
    return content[:offset] + packed + content[offset + len(packed) :]


def text_mutant(content: bytes, random_: random.Random) -> bytes:
    """A text of lines and words with some of them gone, doubled or exchanged."""
    lines = content.decode().splitlines()
    row = random_.randrange(len(lines))
    changes = (
        lines[:row] + lines[row + 1 :],
        [*lines[: row + 1], *lines[row:]],
        lines[: row + 1],
        [*lines[:row], *[_words(lines[row], random_)] * 3, *lines[row + 1 :]],
        [line if line.startswith("#") else _words(line, random_) for line in lines],
        [*lines[:row], "é\0 \x85 1", *lines[row + 1 :]],
    )
    return "\n".join(random_.choice(changes)).encode(random_.choice(("utf-8", "latin-1")))


def _words(line: str, random_: random.Random) -> str:
    words = line.split(" ")
    place = random_.randrange(len(words))
    changes = (
        [*words[:place], random_.choice(WORDS), *words[place + 1 :]],
        words[:place] + words[place + 1 :],
        [*words[: place + 1], *words[place:]],
    )
    return " ".join(random_.choice(changes))


def _floats(body: bytes, random_: random.Random) -> bytes:
    """Some of the numbers of a body of float32 are others."""
    changed = bytearray(body)
    for _ in range(random_.choice((1, 1, 5, 50))):
        if len(changed) >= 4:
            offset = 4 * random_.randrange(len(changed) // 4)
            struct.pack_into("<f", changed, offset, random_.choice(FLOATS))
    return bytes(changed)
