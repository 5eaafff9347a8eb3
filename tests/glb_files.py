"""GLB files taken apart, changed and put together again."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

Json = dict[str, Any]
NAME = "KHR_gaussian_splatting"


def glb_parts(path: Path) -> tuple[Json, bytes]:
    """The JSON of a GLB and its bytes."""
    content = path.read_bytes()
    (size,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def glb_of(document: Json, binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(binary), 0x004E4942) + binary


def changed_glb(path: Path, change: Callable[[Json], object]) -> None:
    """Write a GLB anew with another JSON."""
    document, binary = glb_parts(path)
    change(document)
    path.write_bytes(glb_of(document, binary))


def as_gltf(path: Path, uri: str, change: Callable[[Json], object] = lambda _: None) -> Path:
    """The same file as JSON, its buffer under another name; that buffer is not written."""
    document, _ = glb_parts(path)
    document["buffers"][0]["uri"] = uri
    change(document)
    parted = path.with_suffix(".gltf")
    parted.write_text(json.dumps(document))
    return parted


def attributes(document: Json) -> Json:
    """The accessors of the splats' attributes."""
    return document["meshes"][0]["primitives"][0]["attributes"]


def attribute(document: Json, name: str) -> Json:
    """An accessor."""
    return document["accessors"][attributes(document)[name]]


def places(document: Json) -> Json:
    """Where the bytes of POSITION lie."""
    return document["bufferViews"][attribute(document, "POSITION")["bufferView"]]


def extension(document: Json) -> Json:
    """What makes the points splats."""
    return document["meshes"][0]["primitives"][0]["extensions"][NAME]
