"""The numbers of a glTF file, each stretch of bytes checked before it is taken for rows."""

import base64
import binascii
import re
from dataclasses import dataclass, field
from typing import TypeVar
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.files import inside, read_bytes
from stylesplat.io.splats.gltf_document import Accessor, BufferView, Gltf

T = TypeVar("T")

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
COMPLETE = "Put the files of its folder together again, or export it as .glb."


@dataclass(frozen=True)
class Numbers:
    """The buffers of a file, each loaded when it is needed first."""

    gltf: Gltf
    """The file."""
    loaded: dict[str | int, memoryview] = field(default_factory=dict)
    """By what names them."""
    unpacked: dict[tuple[str | int, int], int] = field(default_factory=dict)
    """Bytes that compressed stretches became, by buffer and where they begin."""

    @property
    def size(self) -> int:
        """Bytes that were loaded, those of compressed stretches as what they became, too."""
        return sum(map(len, self.loaded.values())) + sum(self.unpacked.values())

    def rows(self, index: int, name: str, width: int) -> Float[np.ndarray, "N D"]:
        """The rows of an accessor as float32, integers as their fractions where it says so.

        Args:
            index: Which.
            name: What they are, for messages.
            width: Numbers of a row.

        Raises:
            StyleSplatError: If there are none of that width, or fewer bytes than it claims.
        """
        values = self._stored(index, name, width)
        if values.dtype.kind == "f" or not self.accessor(index, name).normalized:
            return np.array(values, np.float32)
        whole = np.float32(np.iinfo(values.dtype).max)
        return np.maximum(values.astype(np.float32) / whole, np.float32(-1))

    def accessor(self, index: int, name: str) -> Accessor:
        """What is said of the rows."""
        return self._part(self.gltf.document.accessors, index, f"accessor of {name}")

    def step(self, index: int, name: str) -> float:
        """The smallest difference between values below 1."""
        dtype = COMPONENTS[self.accessor(index, name).component_type]
        return 2.0**-24 if dtype.kind == "f" else 1 / np.iinfo(dtype).max

    def _stored(self, index: int, name: str, width: int) -> np.ndarray:
        """The rows as they lie in the file, not copied."""
        accessor = self.accessor(index, name)
        dtype = COMPONENTS.get(accessor.component_type)
        if dtype is None or WIDTHS.get(accessor.type) != width:
            fault = f"the rows of {name} are {accessor.type!r:.20} of {accessor.component_type}"
            raise self.gltf.refusal(f"{fault}, which they cannot be")
        if accessor.sparse is not None or accessor.buffer_view is None:
            fault = f"the rows of {name} are left out or sparse, which is not read here"
            raise self.gltf.refusal(fault, "Export it without compression.")
        row = width * dtype.itemsize
        stretch = self.stretch(accessor.buffer_view, name)
        stride = self._view(accessor.buffer_view, name).byte_stride or row
        end = accessor.byte_offset + (accessor.count - 1) * stride + row
        if stride < row or (accessor.count and end > len(stretch)):
            fault = f"{accessor.count} rows of {name} are to lie {stride} bytes apart"
            raise self.gltf.refusal(f"{fault}, in {len(stretch)} bytes")
        shape, strides = (accessor.count, width), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, stretch, accessor.byte_offset, strides)

    def stretch(self, index: int, name: str) -> memoryview:
        """The bytes of a view, for what `name` says in messages.

        Raises:
            StyleSplatError: If there are none, or fewer than it claims.
        """
        view = self._view(index, name)
        packed = next((each for each in view.extensions if "compression" in each), None)
        if packed is not None:
            fault = f"the rows of {name} are compressed ({brief(packed)}), which is not read here"
            raise self.gltf.refusal(fault, "Export it without compression.")
        content = self._buffer(view.buffer)
        end = view.byte_offset + view.byte_length
        if end > len(content):
            fault = f"the rows of {name} are to end at byte {end} of {len(content)}"
            raise self.gltf.refusal(fault)
        return content[view.byte_offset : end]

    def count_unpacked(self, index: int, size: int) -> None:
        """Tell how many bytes a view became; of views of the same bytes one counts."""
        view = self._view(index, "SPZ")
        buffer = self.gltf.document.buffers[view.buffer].uri or view.buffer
        self.unpacked[buffer, view.byte_offset] = size

    def _view(self, index: int, name: str) -> BufferView:
        return self._part(self.gltf.document.buffer_views, index, f"view of {name}")

    def _buffer(self, index: int) -> memoryview:
        """The bytes of a buffer, as many as it says."""
        buffer = self._part(self.gltf.document.buffers, index, "buffer")
        binary, key = self.gltf.binary, buffer.uri or index
        if key not in self.loaded:
            if buffer.uri is not None:
                self.loaded[key] = memoryview(self._bytes_of(buffer.uri))
            elif index == 0 and binary is not None:
                self.loaded[key] = binary
            else:
                raise self.gltf.refusal(f"its buffer {index} is nowhere", COMPLETE)
        content = self.loaded[key]
        if buffer.byte_length > len(content):
            fault = f"buffer {index} is to have {buffer.byte_length} bytes, it has {len(content)}"
            raise self.gltf.refusal(fault)
        return content[: buffer.byte_length]

    def _bytes_of(self, uri: str) -> bytes:
        """What a link within the file, or to a file of its folder, leads to."""
        embedded = EMBEDDED.match(uri)
        if embedded:
            try:
                return base64.b64decode(uri[embedded.end() :], validate=True)
            except (binascii.Error, ValueError) as error:
                raise self.gltf.refusal(f"an embedded buffer is no base64 ({error})") from error
        name, folder = unquote(uri), self.gltf.path.parent
        if ELSEWHERE.match(name):
            raise self._astray(uri)
        try:
            place = inside(folder, name)
        except (StyleSplatError, OSError, ValueError) as error:
            raise self._astray(uri) from error
        return read_bytes(place)

    def _astray(self, uri: str) -> StyleSplatError:
        fault = f"its buffer {brief(uri)!r} lies outside its folder, where nothing is read"
        return self.gltf.refusal(fault, COMPLETE)

    def _part(self, parts: list[T], index: int, name: str) -> T:
        if index >= len(parts):
            raise self.gltf.refusal(f"it has no {name}: number {index} of {len(parts)}")
        return parts[index]
