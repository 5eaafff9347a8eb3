"""glTF 2.0 files: the container, the JSON as far as splats need it, and the numbers in buffers.

The format is Khronos' (https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html). pygltflib reads
all of a file and follows its links before anything can be checked, so this reader is our own.
"""

import base64
import binascii
import re
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar
from urllib.parse import unquote

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.files import inside, read_bytes
from stylesplat.io.ply import report_extra

T = TypeVar("T")

SPLATTING = "KHR_gaussian_splatting"
SPZ = (f"{SPLATTING}_compression_spz_2", f"{SPLATTING}_compression_spz")  # now, and before
DISPLAYED = "srgb_rec709_display"  # the colour space of all our splats
MAGIC = b"glTF"
HEADER = struct.Struct("<4sII")  # magic, version, bytes of the file
CHUNK = struct.Struct("<I4s")  # bytes of the chunk, kind
JSON, BINARY = b"JSON", b"BIN\0"
VERSION = 2
MAX_COMMAS = 2**20  # in the JSON, which may take 200 bytes of memory for each; buffers have one
COMPONENTS = {
    5120: np.dtype("i1"),
    5121: np.dtype("u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5126: np.dtype("<f4"),
}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
EMBEDDED = re.compile(r"data:[\w.+-]*/?[\w.+-]*;base64,")
ELSEWHERE = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:|[/\\]")  # a scheme, a drive, or a root
AGAIN = "Export it again."
COMPLETE = "Put the files of its folder together again, or export it as .glb."

Natural = Annotated[int, Meta(ge=0, le=2**53)]
"""A size or an index, as large as JSON's numbers are exact."""
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


class _Part(Struct, frozen=True, rename="camel"):
    """A part of the JSON, whose names are in camel case; see the specification."""


class Buffer(_Part, frozen=True):
    byte_length: Natural
    uri: str | None = None


class BufferView(_Part, frozen=True):
    buffer: Natural
    byte_length: Natural
    byte_offset: Natural = 0
    byte_stride: Annotated[int, Meta(ge=1, le=252)] | None = None
    extensions: dict[str, Any] = {}


class Accessor(_Part, frozen=True):
    component_type: int
    count: Natural
    type: str
    buffer_view: Natural | None = None
    byte_offset: Natural = 0
    normalized: bool = False
    sparse: dict[str, Any] | None = None


class Splatting(_Part, frozen=True):
    kernel: str = "ellipse"
    color_space: str = DISPLAYED
    extensions: dict[str, Any] = {}


class Extensions(Struct, frozen=True, rename={"splatting": SPLATTING}):
    splatting: Splatting | None = None


class Primitive(_Part, frozen=True):
    attributes: dict[str, Natural]
    mode: int = 4
    extensions: Extensions = Extensions()


class Mesh(_Part, frozen=True):
    primitives: list[Primitive]


class Node(_Part, frozen=True):
    mesh: Natural | None = None
    children: list[Natural] = []
    matrix: Annotated[list[float], Meta(min_length=16, max_length=16)] | None = None
    translation: Three = (0.0, 0.0, 0.0)
    rotation: Four = (0.0, 0.0, 0.0, 1.0)
    scale: Three = (1.0, 1.0, 1.0)


class NodeList(_Part, frozen=True):
    nodes: list[Natural] = []


class Asset(_Part, frozen=True):
    version: str


class Document(_Part, frozen=True):
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
    """An opened file. Its buffers are loaded when they are needed, and each range is checked."""

    path: Path
    document: Document
    binary: memoryview | None
    """The binary chunk of a GLB."""
    loaded: dict[str | int, memoryview] = field(default_factory=dict)
    """Buffers by URI or index."""

    def refusal(self, fault: str, remedy: str = AGAIN) -> StyleSplatError:
        return _refusal(self.path, fault, remedy)

    @property
    def size(self) -> int:
        return sum(map(len, self.loaded.values()))

    def accessor(self, index: int, name: str) -> Accessor:
        """An accessor; `name` says in messages what its rows are."""
        return self._part(self.document.accessors, index, f"accessor of {name}")

    def rows(self, index: int, name: str, width: int) -> Float[np.ndarray, "N D"]:
        """The rows of an accessor as float32; normalized integers become fractions."""
        accessor = self.accessor(index, name)
        dtype = COMPONENTS.get(accessor.component_type)
        if dtype is None or WIDTHS.get(accessor.type) != width:
            fault = f"the rows of {name} are {accessor.type!r:.20} of {accessor.component_type}"
            raise self.refusal(f"{fault}, which they cannot be")
        if accessor.sparse is not None or accessor.buffer_view is None:
            fault = f"the rows of {name} are left out or sparse, which is not read here"
            raise self.refusal(fault, "Export it without compression.")
        row = width * dtype.itemsize
        content = self.view_bytes(accessor.buffer_view, name)
        stride = self._view(accessor.buffer_view, name).byte_stride or row
        end = accessor.byte_offset + (accessor.count - 1) * stride + row
        if stride < row or (accessor.count and end > len(content)):
            fault = f"{accessor.count} rows of {name} are to lie {stride} bytes apart"
            raise self.refusal(f"{fault}, in {len(content)} bytes")
        shape, strides = (accessor.count, width), (stride, dtype.itemsize)
        values = np.ndarray(shape, dtype, content, accessor.byte_offset, strides)
        if values.dtype.kind == "f" or not accessor.normalized:
            return np.array(values, np.float32)
        whole = np.float32(np.iinfo(values.dtype).max)
        return np.maximum(values.astype(np.float32) / whole, np.float32(-1))

    def step(self, index: int, name: str) -> float:
        """The smallest difference between values of an accessor below 1."""
        dtype = COMPONENTS[self.accessor(index, name).component_type]
        return 2.0**-24 if dtype.kind == "f" else 1 / np.iinfo(dtype).max

    def view_bytes(self, index: int, name: str) -> memoryview:
        view = self._view(index, name)
        packed = next((each for each in view.extensions if "compression" in each), None)
        if packed is not None:
            fault = f"the rows of {name} are compressed ({brief(packed)}), which is not read here"
            raise self.refusal(fault, "Export it without compression.")
        content = self._buffer(view.buffer)
        end = view.byte_offset + view.byte_length
        if end > len(content):
            raise self.refusal(f"the rows of {name} are to end at byte {end} of {len(content)}")
        return content[view.byte_offset : end]

    def _view(self, index: int, name: str) -> BufferView:
        return self._part(self.document.buffer_views, index, f"view of {name}")

    def _buffer(self, index: int) -> memoryview:
        buffer = self._part(self.document.buffers, index, "buffer")
        key = buffer.uri or index
        if key not in self.loaded:
            if buffer.uri is not None:
                self.loaded[key] = memoryview(self._load(buffer.uri))
            elif index == 0 and self.binary is not None:
                self.loaded[key] = self.binary
            else:
                raise self.refusal(f"its buffer {index} is nowhere", COMPLETE)
        content = self.loaded[key]
        if buffer.byte_length > len(content):
            fault = f"buffer {index} is to have {buffer.byte_length} bytes, it has {len(content)}"
            raise self.refusal(fault)
        return content[: buffer.byte_length]

    def _load(self, uri: str) -> bytes:
        """The bytes of a data URI, or of a file in the same folder."""
        embedded = EMBEDDED.match(uri)
        if embedded:
            try:
                return base64.b64decode(uri[embedded.end() :], validate=True)
            except (binascii.Error, ValueError) as error:
                raise self.refusal(f"an embedded buffer is no base64 ({error})") from error
        name = unquote(uri)
        try:
            if ELSEWHERE.match(name):
                raise ValueError(name)
            file = inside(self.path.parent, name)
        except (StyleSplatError, OSError, ValueError) as error:
            fault = f"its buffer {brief(uri)!r} lies outside its folder, where nothing is read"
            raise self.refusal(fault, COMPLETE) from error
        return read_bytes(file)

    def _part(self, parts: list[T], index: int, name: str) -> T:
        if index >= len(parts):
            raise self.refusal(f"it has no {name}: number {index} of {len(parts)}")
        return parts[index]


def attribute(name: str) -> str:
    """The full name of an attribute of splats."""
    return f"{SPLATTING}:{name}"


def harmonic(degree: int, number: int) -> str:
    """The attribute of a band of colour."""
    return attribute(f"SH_DEGREE_{degree}_COEF_{number}")


def higher_bands(degree: int) -> list[str]:
    """The attributes of the bands of degree 1 to `degree`, in the order of `shN`."""
    return [harmonic(each, n) for each in range(1, degree + 1) for n in range(2 * each + 1)]


def open_gltf(path: Path) -> Gltf:
    """Open a `.glb` or `.gltf` file; its header and JSON are checked, its buffers are not read."""
    content = read_bytes(path)
    packed = content.startswith(MAGIC)
    if packed != (path.suffix.lower() == ".glb"):
        kind = "a GLB, whose name ends in .glb" if packed else "no GLB"
        raise _refusal(path, f"it is {kind}", "Check the name.")
    text, binary = _chunks(path, content) if packed else (content, None)
    document = _document(path, text)
    if document.asset.version.split(".")[0] != str(VERSION):
        fault = f"it is of version {document.asset.version!r:.20}, not {VERSION}.0"
        raise _refusal(path, fault, "Export it as glTF 2.0.")
    return Gltf(path, document, binary)


def _chunks(path: Path, content: bytes) -> tuple[bytes, memoryview | None]:
    """The JSON of a GLB, and its binary chunk if it has one."""
    if len(content) < HEADER.size + CHUNK.size:
        raise _refusal(path, f"it is cut off after {len(content)} bytes")
    _, version, announced = HEADER.unpack_from(content)
    if version != VERSION:
        raise _refusal(path, f"it is a GLB of version {version}, not {VERSION}")
    if announced > len(content):
        fault = f"its header announces a file of {announced} bytes, it holds {len(content)}"
        raise _refusal(path, fault)
    report_extra(path, len(content) - announced)
    chunks, rest = [], memoryview(content)[HEADER.size : announced]
    while len(rest) >= CHUNK.size and len(chunks) < 2:
        size, kind = CHUNK.unpack_from(rest)
        if size > len(rest) - CHUNK.size:
            fault = f"a chunk is to have {size} bytes, {len(rest) - CHUNK.size} are left"
            raise _refusal(path, fault)
        chunks.append((kind, rest[CHUNK.size : CHUNK.size + size]))
        rest = rest[CHUNK.size + size :]
    if not chunks or chunks[0][0] != JSON:
        raise _refusal(path, "it does not begin with a chunk of JSON")
    binary = chunks[1][1] if chunks[1:] and chunks[1][0] == BINARY else None
    return bytes(chunks[0][1]), binary


def _document(path: Path, text: bytes) -> Document:
    commas = text.count(b",")
    if commas > MAX_COMMAS:
        raise _refusal(path, f"its JSON has {commas} parts, more than {MAX_COMMAS}")
    try:
        return msgspec.json.decode(text, type=Document)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise _refusal(path, f"its JSON is none of glTF ({error})") from error


def _refusal(path: Path, fault: str, remedy: str = AGAIN) -> StyleSplatError:
    return StyleSplatError(f"Cannot read {path} as glTF: {fault}. {remedy}")
