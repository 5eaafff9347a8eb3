"""What a glTF 2.0 file says of itself, as far as splats need it, and its bytes.

The format is Khronos' (https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html). Its container is
a header and two chunks, and a library for it (pygltflib) reads all of a file and follows its links
before anything can be checked, so this is our own: types that msgspec holds the JSON to.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import read_bytes
from stylesplat.io.ply import say_left_over

SPLATTING = "KHR_gaussian_splatting"
SPZ = (f"{SPLATTING}_compression_spz_2", f"{SPLATTING}_compression_spz")  # now, and before
DISPLAYED = "srgb_rec709_display"  # the colour space of all our splats
MAGIC = b"glTF"
HEADER = struct.Struct("<4sII")  # magic, version, bytes of the file
CHUNK = struct.Struct("<I4s")  # bytes of the chunk, kind
JSON, BINARY = b"JSON", b"BIN\0"
VERSION = 2
MAX_PARTS = 2**20  # of the JSON, by its commas: "{}" becomes 200 bytes; buffers have one comma
AGAIN = "Export it again."

Natural = Annotated[int, Meta(ge=0, le=2**53)]
"""A size or an index, as large as JSON's numbers are exact."""
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


class _Part(Struct, frozen=True, rename="camel"):
    """What the format has in its own spelling."""


class Buffer(_Part, frozen=True):
    """Bytes, of this file or another one."""

    byte_length: Natural
    uri: str | None = None


class BufferView(_Part, frozen=True):
    """A stretch of a buffer."""

    buffer: Natural
    byte_length: Natural
    byte_offset: Natural = 0
    byte_stride: Annotated[int, Meta(ge=1, le=252)] | None = None
    extensions: dict[str, Any] = {}


class Accessor(_Part, frozen=True):
    """Rows of numbers in a stretch."""

    component_type: int
    count: Natural
    type: str
    buffer_view: Natural | None = None
    byte_offset: Natural = 0
    normalized: bool = False
    sparse: dict[str, Any] | None = None


class Splatting(_Part, frozen=True):
    """What makes points splats."""

    kernel: str = "ellipse"
    color_space: str = DISPLAYED
    extensions: dict[str, Any] = {}


class Packed(_Part, frozen=True):
    """Where SPZ lies that has all attributes of splats."""

    buffer_view: Natural


class Extensions(Struct, frozen=True, rename={"splatting": SPLATTING}):
    """Of a primitive."""

    splatting: Splatting | None = None


class Primitive(_Part, frozen=True):
    """What is drawn at once."""

    attributes: dict[str, Natural]
    mode: int = 4
    extensions: Extensions = Extensions()


class Mesh(_Part, frozen=True):
    """What is drawn at one place."""

    primitives: list[Primitive]


class Node(_Part, frozen=True):
    """A place, within its parent's."""

    mesh: Natural | None = None
    children: list[Natural] = []
    matrix: Annotated[list[float], Meta(min_length=16, max_length=16)] | None = None
    translation: Three = (0.0, 0.0, 0.0)
    rotation: Four = (0.0, 0.0, 0.0, 1.0)
    scale: Three = (1.0, 1.0, 1.0)


class NodeList(_Part, frozen=True):
    """The roots of a scene."""

    nodes: list[Natural] = []


class Asset(_Part, frozen=True):
    """Which version of the format it is."""

    version: str


class Document(_Part, frozen=True):
    """All of it."""

    asset: Asset
    scene: Natural = 0
    scenes: list[NodeList] = []
    nodes: list[Node] = []
    meshes: list[Mesh] = []
    accessors: list[Accessor] = []
    buffer_views: list[BufferView] = []
    buffers: list[Buffer] = []
    extensions_used: list[str] = []


@dataclass(frozen=True)
class Gltf:
    """A file that was opened: its numbers were not looked at yet."""

    path: Path
    """Where it lies."""
    document: Document
    """Its JSON."""
    binary: memoryview | None
    """The bytes that a GLB brings along."""

    def refusal(self, fault: str, remedy: str = AGAIN) -> StyleSplatError:
        """What to say if it cannot be read."""
        return refusal(self.path, fault, remedy)


def named(attribute: str) -> str:
    """The name of an attribute of splats."""
    return f"{SPLATTING}:{attribute}"


def harmonic(degree: int, number: int) -> str:
    """The name of a band of colour."""
    return named(f"SH_DEGREE_{degree}_COEF_{number}")


def higher_bands(degree: int) -> list[str]:
    """The names of the bands above the constant one up to a degree, in the order of `shN`."""
    return [harmonic(each, n) for each in range(1, degree + 1) for n in range(2 * each + 1)]


def refusal(path: Path, fault: str, remedy: str = AGAIN) -> StyleSplatError:
    """What to say of a file that cannot be read."""
    return StyleSplatError(f"Cannot read {path} as glTF: {fault}. {remedy}")


def open_gltf(path: Path) -> Gltf:
    """Open a `.glb` or `.gltf` file: its header and JSON are checked, its numbers are not.

    Raises:
        StyleSplatError: If it is missing, of another kind than its name says, damaged, or of
            another version than 2.
    """
    content = read_bytes(path)
    packed = content.startswith(MAGIC)
    if packed != (path.suffix.lower() == ".glb"):
        held = "a GLB, whose name ends in .glb" if packed else "no GLB"
        raise refusal(path, f"it is {held}", "Check the name.")
    text, binary = _chunks(path, content) if packed else (content, None)
    document = _document(path, text)
    if document.asset.version.split(".")[0] != str(VERSION):
        fault = f"it is of version {document.asset.version!r:.20}, not {VERSION}.0"
        raise refusal(path, fault, "Export it as glTF 2.0.")
    return Gltf(path, document, binary)


def open_json(path: Path) -> Gltf:
    """As `open_gltf`, but of a GLB only the JSON is read: its bytes are not there.

    Raises:
        StyleSplatError: If it is missing, or that is damaged.
    """
    head = read_bytes(path, first=HEADER.size + CHUNK.size)
    if not head.startswith(MAGIC) or len(head) < HEADER.size + CHUNK.size:
        return open_gltf(path)
    size, _ = CHUNK.unpack_from(head, HEADER.size)
    text = read_bytes(path, first=len(head) + size)[len(head) :]
    return Gltf(path, _document(path, text), None)


def _chunks(path: Path, content: bytes) -> tuple[bytes, memoryview | None]:
    """The JSON of a GLB, and its bytes if it has some."""
    if len(content) < HEADER.size + CHUNK.size:
        raise refusal(path, f"it is cut off after {len(content)} bytes")
    _, version, announced = HEADER.unpack_from(content)
    if version != VERSION:
        raise refusal(path, f"it is a GLB of version {version}, not {VERSION}")
    if announced > len(content):
        fault = f"its header announces a file of {announced} bytes, it holds {len(content)}"
        raise refusal(path, fault)
    say_left_over(path, len(content) - announced)
    chunks, rest = [], memoryview(content)[HEADER.size : announced]
    while len(rest) >= CHUNK.size and len(chunks) < 2:
        size, kind = CHUNK.unpack_from(rest)
        if size > len(rest) - CHUNK.size:
            fault = f"a chunk is to have {size} bytes, {len(rest) - CHUNK.size} are left"
            raise refusal(path, fault)
        chunks.append((kind, rest[CHUNK.size : CHUNK.size + size]))
        rest = rest[CHUNK.size + size :]
    if not chunks or chunks[0][0] != JSON:
        raise refusal(path, "it does not begin with a chunk of JSON")
    binary = chunks[1][1] if chunks[1:] and chunks[1][0] == BINARY else None
    return bytes(chunks[0][1]), binary


def _document(path: Path, text: bytes) -> Document:
    parts = text.count(b",")
    if parts > MAX_PARTS:
        raise refusal(path, f"its JSON has {parts} parts, more than {MAX_PARTS}")
    try:
        return msgspec.json.decode(text, type=Document)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise refusal(path, f"its JSON is none of glTF ({error})") from error
