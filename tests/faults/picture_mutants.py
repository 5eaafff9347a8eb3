"""Pictures that say to be larger, or stored otherwise, than they are."""

import random
import struct
import zlib

SIDES = (0, 1, 2, 31, 500, 20_000, 60_000, 65_535, 2**31 - 1, 2**32 - 1)
PNG_HEADER = slice(16, 29)  # of IHDR: width, height, depth, colour and so on
TIFF_VALUES = (0, 1, 2, 3, 7, 8, 16, 32, 255, 34_712, 60_000, 65_535)
JPEG_FRAMES = (b"\xff\xc0", b"\xff\xc1", b"\xff\xc2")


def png_size_mutant(content: bytes, random_: random.Random) -> bytes:
    """Another header, its check sum right."""
    header = bytearray(content[PNG_HEADER])
    if random_.random() < 0.7:
        struct.pack_into(">I", header, random_.choice((0, 4)), random_.choice(SIDES))
    else:
        header[random_.randrange(8, 13)] = random_.choice((0, 1, 2, 3, 4, 6, 16, 255))
    check = struct.pack(">I", zlib.crc32(b"IHDR" + header))
    return content[:16] + header + check + content[33:]


def jpeg_size_mutant(content: bytes, random_: random.Random) -> bytes:
    """Another size or number of channels."""
    start = next((content.find(m) for m in JPEG_FRAMES if content.find(m) >= 0), 2)
    changed = bytearray(content)
    if random_.random() < 0.8:
        side = random_.choice(SIDES) % 2**16
        struct.pack_into(">H", changed, start + random_.choice((5, 7)), side)
    else:
        changed[start + 9] = random_.choice((0, 1, 2, 4, 255))
    return bytes(changed)


def tiff_tag_mutant(content: bytes, random_: random.Random) -> bytes:
    """Another value, type or number of values of a tag (little-endian, the first directory)."""
    changed = bytearray(content)
    (directory,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, directory)
    entry = directory + 2 + 12 * random_.randrange(count)
    match random_.randrange(4):
        case 0:
            struct.pack_into("<H", changed, entry, random_.choice((256, 257, 258, 259, 262, 277)))
        case 1:
            struct.pack_into("<H", changed, entry + 2, random_.randrange(16))
        case 2:
            struct.pack_into("<I", changed, entry + 4, random_.choice(SIDES))
        case _:
            value = random_.choice((*TIFF_VALUES, *SIDES))
            struct.pack_into("<I", changed, entry + 8, value)
    return bytes(changed)


def webp_size_mutant(content: bytes, random_: random.Random) -> bytes:
    """Another size of the picture or of its chunks."""
    changed = bytearray(content)
    if random_.random() < 0.5:
        struct.pack_into("<I", changed, random_.choice((4, 16)), random_.choice(SIDES))
    else:  # width and height of 14 bits each, behind the frame's start
        struct.pack_into("<H", changed, random_.choice((21, 23, 26, 28)), random_.randrange(2**16))
    return bytes(changed)
