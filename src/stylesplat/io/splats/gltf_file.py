"""glTF 2.0 files: the container, the JSON as far as splats need it, and the numbers in buffers.

The format is Khronos' (https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html). pygltflib reads
all of a file and follows its links before anything can be checked, so this reader is our own. What
does not fit is a ValueError, which `read_splats` turns into a StyleSplatError that names the file.
"""

import base64
import json
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar
from urllib.parse import unquote

import msgspec
import numpy as np
from jaxtyping import Float, Shaped
from msgspec import Meta, Struct
from scipy.spatial.transform import Rotation

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.io.files import read_bytes, resolve_within
from stylesplat.io.ply import BOM

T = TypeVar("T")

SPLATTING = "KHR_gaussian_splatting"
DISPLAYED = "srgb_rec709_display"  # the colour space of all our splats
GLB_MAGIC = b"glTF"
GLB_HEADER = struct.Struct("<4sII")  # magic, version, bytes of the file
GLB_CHUNK = struct.Struct("<I4s")  # bytes of the chunk, kind
JSON, GLB_BINARY = b"JSON", b"BIN\0"
GLB_VERSION = 2
MAX_COMMAS = 2**20  # in the JSON, which may take 200 bytes of memory for each; buffers have one
GL_FLOAT, SHORT, BYTE = 5126, 5123, 5121
COMPONENTS = {5120: "i1", BYTE: "u1", 5122: "<i2", SHORT: "<u2", GL_FLOAT: "<f4"}
GL_UINT32 = 5125  # of indices alone
STORED = COMPONENTS | {GL_UINT32: "<u4"}
GLB_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
GLB_WIDTHS = {kind: width for width, kind in GLB_KINDS.items()}
EMBEDDED = re.compile(r"data:[\w.+-]*/?[\w.+-]*;base64,")
ELSEWHERE = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:|[/\\]")  # a scheme, a drive, or a root

Natural = Annotated[int, Meta(ge=0, le=2**53)]
"""A size or an index, as large as JSON's numbers are exact."""
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


def padded_json(document: dict[str, Any]) -> bytes:
    """The content of a GLB's first chunk."""
    text = json.dumps(document, separators=(",", ":")).encode()
    return text + b" " * (-len(text) % 4)


def glb_size(text: bytes, size: int) -> int:
    """Bytes of a GLB with this JSON, and so many bytes in its binary chunk."""
    return GLB_HEADER.size + 2 * GLB_CHUNK.size + len(text) + size


def glb_head(text: bytes, size: int) -> bytes:
    """What such a GLB begins with, before the bytes of its binary chunk."""
    head = GLB_HEADER.pack(GLB_MAGIC, GLB_VERSION, glb_size(text, size)) + GLB_CHUNK.pack(
        len(text), JSON
    )
    return head + text + GLB_CHUNK.pack(size, GLB_BINARY)


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


class Compression(_Part, frozen=True):
    buffer_view: Natural | None = None


class Splatting(_Part, frozen=True):
    kernel: str = "ellipse"
    color_space: str = DISPLAYED
    projection: str = "perspective"
    sorting_method: str = "cameraDistance"
    extensions: dict[str, Compression] = {}


class Extensions(Struct, frozen=True, rename={"splatting": SPLATTING}):
    splatting: Splatting | None = None


class Primitive(_Part, frozen=True):
    attributes: dict[str, Natural]
    extensions: Extensions = Extensions()


class Mesh(_Part, frozen=True):
    primitives: list[Primitive]


class Node(_Part, frozen=True):
    name: Any = None
    mesh: Natural | None = None
    skin: Any = None
    children: list[Natural] = []
    matrix: Annotated[list[float], Meta(min_length=16, max_length=16)] | None = None
    translation: Three = (0.0, 0.0, 0.0)
    rotation: Four = (0.0, 0.0, 0.0, 1.0)
    scale: Three = (1.0, 1.0, 1.0)


class NodeList(_Part, frozen=True):
    nodes: list[Natural] = []


class Document(_Part, frozen=True):
    asset: dict[str, Any]
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

    @property
    def size(self) -> int:
        return sum(map(len, self.loaded.values()))

    def rows(self, primitive: Primitive, name: str, width: int) -> Float[np.ndarray, "N D"]:
        """The rows of an attribute as float32; normalized integers become fractions."""
        if name not in primitive.attributes:
            raise ValueError(f"its splats have no {name}")
        index = primitive.attributes[name]
        accessor = _part(self.document.accessors, index, f"accessor of {name}")
        if accessor.component_type not in COMPONENTS or accessor.type != GLB_KINDS[width]:
            kind = f"{accessor.type!r:.20} of {accessor.component_type}"
            raise ValueError(f"the rows of {name} have the wrong type: {kind}")
        return self.fractions(index, name)

    def fractions(self, index: int, name: str) -> Float[np.ndarray, "N D"]:
        """The rows of an accessor as float32; normalized integers become fractions."""
        values = self.stored(index, name)
        if values.dtype.kind == "f" or not self.document.accessors[index].normalized:
            return np.array(values, np.float32)
        whole = np.float32(np.iinfo(values.dtype).max)
        return np.maximum(values.astype(np.float32) / whole, np.float32(-1))

    def stored(self, index: int, name: str) -> Shaped[np.ndarray, "N D"]:
        """The rows of an accessor as they are in the file."""
        accessor = _part(self.document.accessors, index, f"accessor of {name}")
        if accessor.component_type not in STORED or accessor.type not in GLB_WIDTHS:
            kind = f"{accessor.type!r:.20} of {accessor.component_type}"
            raise ValueError(f"the rows of {name} have the wrong type: {kind}")
        if accessor.sparse is not None or accessor.buffer_view is None:
            raise ValueError(f"the rows of {name} are left out or sparse, which is not read here")
        content, stride = self.view(accessor.buffer_view, name)
        dtype, width = np.dtype(STORED[accessor.component_type]), GLB_WIDTHS[accessor.type]
        stride = stride or width * dtype.itemsize
        end = accessor.byte_offset + (accessor.count - 1) * stride + width * dtype.itemsize
        if stride < width * dtype.itemsize or (accessor.count and end > len(content)):
            fault = f"{accessor.count} rows of {name}, {stride} bytes apart, do not fit"
            raise ValueError(f"{fault} into {len(content)} bytes")
        shape, strides = (accessor.count, width), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, content, accessor.byte_offset, strides)

    def view(self, index: int, name: str) -> tuple[memoryview, int | None]:
        """The bytes of a buffer view, and how far its rows lie apart."""
        view = _part(self.document.buffer_views, index, f"view of {name}")
        packed = next((each for each in view.extensions if "compression" in each), None)
        if packed is not None:
            fault = f"the rows of {name} are compressed ({shorten(packed)}), which is not read here"
            raise ValueError(f"{fault}. Export it without compression")
        content, end = self._buffer(view.buffer), view.byte_offset + view.byte_length
        if end > len(content):
            raise ValueError(f"the rows of {name} end at byte {end}, its buffer at {len(content)}")
        return content[view.byte_offset : end], view.byte_stride

    def _buffer(self, index: int) -> memoryview:
        buffer = _part(self.document.buffers, index, "buffer")
        key = buffer.uri or index
        if key not in self.loaded:
            if buffer.uri is not None:
                self.loaded[key] = memoryview(self.load_uri(buffer.uri))
            elif index == 0 and self.binary is not None:
                self.loaded[key] = self.binary
            else:
                raise ValueError(f"its buffer {index} is missing")
        content = self.loaded[key]
        if buffer.byte_length > len(content):
            size = f"{buffer.byte_length} bytes, but has {len(content)}"
            raise ValueError(f"buffer {index} should have {size}")
        return content[: buffer.byte_length]

    def load_uri(self, uri: str) -> bytes:
        """The bytes of a data URI, or of a file in the same folder."""
        embedded = EMBEDDED.match(uri)
        if embedded:
            return base64.b64decode(uri[embedded.end() :], validate=True)
        name = unquote(uri)
        try:
            if ELSEWHERE.match(name):
                raise ValueError(name)
            file = resolve_within(self.path.parent, name)
        except (StyleSplatError, OSError, ValueError) as error:
            fault = f"its buffer {shorten(uri)!r} lies outside its folder, where nothing is read"
            raise ValueError(fault) from error
        return read_bytes(file)


def _part(parts: list[T], index: int, name: str) -> T:
    if index >= len(parts):
        raise ValueError(f"it has no {name}: number {index} of {len(parts)}")
    return parts[index]


NodeNames = tuple[Any, str] | None
"""The name of a node, after those of the nodes above it."""


def placed_nodes(
    document: Document,
) -> Iterator[tuple[Node, Float[np.ndarray, "4 4"], NodeNames]]:
    """The scene's nodes, their transforms to its world, and the names down to each of them."""
    nodes, visited = document.nodes, set[int]()
    if document.scenes:
        roots = document.scenes[min(document.scene, len(document.scenes) - 1)].nodes
    else:
        children = {child for node in nodes for child in node.children}
        roots = [index for index in range(len(nodes)) if index not in children]
    stack: list[tuple[int, Float[np.ndarray, "4 4"], NodeNames]]
    stack = [(root, np.eye(4), None) for root in reversed(roots)]
    while stack:
        index, above, names = stack.pop()
        if index in visited or index >= len(nodes):
            raise ValueError(f"its nodes are no tree (at node {index} of {len(nodes)})")
        visited.add(index)
        node = nodes[index]
        matrix = above @ _matrix_of(node)
        names = (names, node.name) if node.name and isinstance(node.name, str) else names
        yield node, matrix, names
        stack += [(child, matrix, names) for child in reversed(node.children)]


def _matrix_of(node: Node) -> Float[np.ndarray, "4 4"]:
    """The transform of a node to that above it."""
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T  # column-major
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(node.rotation).as_matrix() * node.scale
    matrix[:3, 3] = node.translation
    return matrix


def attribute(name: str) -> str:
    """The full name of an attribute of splats."""
    return f"{SPLATTING}:{name}"


def harmonics(degree: int) -> list[str]:
    """The attributes of the bands of colour up to a degree, in the order of `sh0` and `shN`."""
    numbers = [(each, n) for each in range(degree + 1) for n in range(2 * each + 1)]
    return [attribute(f"SH_DEGREE_{each}_COEF_{n}") for each, n in numbers]


def open_gltf(path: Path) -> Gltf:
    """Open a `.glb` or `.gltf` file; its header and JSON are checked, its buffers are not read."""
    content = read_bytes(path)
    if content.startswith(GLB_MAGIC):
        text, binary, _ = split_glb(content)
        return parse_gltf(path, text, binary)
    return parse_gltf(path, content, None)


def parse_gltf(path: Path, text: bytes, binary: memoryview | None) -> Gltf:
    """The file of this JSON and binary chunk."""
    text = text.removeprefix(BOM)
    commas = text.count(b",")
    if commas > MAX_COMMAS:
        raise ValueError(f"its JSON has {commas} parts, more than {MAX_COMMAS}")
    document = msgspec.json.decode(text, type=Document)
    version = document.asset.get("version")
    if str(version).partition(".")[0] != str(GLB_VERSION):
        raise ValueError(f"it is of version {version!r:.20}, not {GLB_VERSION}.0")
    return Gltf(path, document, binary)


def split_glb(content: bytes) -> tuple[bytes, memoryview | None, memoryview]:
    """The JSON of a GLB, its binary chunk if it has one, and the bytes of other chunks."""
    if len(content) < GLB_HEADER.size or not content.startswith(GLB_MAGIC):
        raise ValueError("it does not begin as a GLB does")
    _, version, announced = GLB_HEADER.unpack_from(content)
    if version != GLB_VERSION:
        raise ValueError(f"it is a GLB of version {version}, not {GLB_VERSION}")
    chunks, rest = {}, memoryview(content)[GLB_HEADER.size : announced]
    while len(rest) >= GLB_CHUNK.size and len(chunks) < 2:
        size, kind = GLB_CHUNK.unpack_from(rest)
        rest = rest[GLB_CHUNK.size :]
        if size > len(rest):
            raise ValueError(f"a chunk should have {size} bytes, but {len(rest)} are left")
        chunks.setdefault(kind, rest[:size])
        rest = rest[size:]
    if JSON not in chunks:
        raise ValueError("it has no chunk of JSON")
    return bytes(chunks[JSON]), chunks.get(GLB_BINARY), rest
