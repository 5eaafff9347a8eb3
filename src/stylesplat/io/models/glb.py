"""Meshes of a GLB, read, and written again with other base colours and no other change.

The JSON is changed as plain values, so that what is unknown here stays; new numbers and pictures
follow the bytes that the file had, which stay, too.
"""

import json
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8

from stylesplat.io.images import decode_embedded, picture_bytes
from stylesplat.io.models.model import Model, PaintedPart, Part
from stylesplat.io.splats.gltf_file import (
    GL_FLOAT,
    GL_UINT32,
    GLB_KINDS,
    SPLATTING,
    Gltf,
    NodeNames,
    glb_head,
    padded_json,
    parse_gltf,
    placed_nodes,
    split_glb,
)

TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives that have faces
TRANSFORM, WEBP_TEXTURE = "KHR_texture_transform", "EXT_texture_webp"
# How meshes or base colours may be stored, which is not read here
GLB_UNREAD = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
GLB_UNREAD |= {"KHR_materials_pbrSpecularGlossiness", "KHR_texture_basisu"}
SPLATS_FOUND = "it holds splats, of which `stylesplat import` makes a scene to paint"
JPEG_TYPE, PNG_TYPE = "image/jpeg", "image/png"
POSITION, COLOR = "POSITION", "COLOR_0"

Json = dict[str, Any]


@dataclass(frozen=True, eq=False)
class GlbContent:
    """A GLB as it was read."""

    gltf: Gltf
    text: bytes
    rest: bytes
    """Other chunks than its first two."""


def parse_glb(path: Path, content: bytes) -> Model:
    """Read the triangles of a GLB's default scene, each mesh where it comes first."""
    text, binary, rest = split_glb(content)
    gltf, document = parse_gltf(path, text, binary), json.loads(text)
    used = {*document.get("extensionsUsed", ())}
    if SPLATTING in used:
        raise ValueError(SPLATS_FOUND)
    if used & GLB_UNREAD:
        raise ValueError(f"it uses {min(used & GLB_UNREAD)}, which is not read here")
    if binary is None or "uri" in document["buffers"][0]:
        raise ValueError("its numbers lie outside it. Export it as one .glb")
    names, places = dict[int, tuple[str, ...]](), dict[int, Float[np.ndarray, "4 4"]]()
    for node, place, own in placed_nodes(gltf.document):
        if node.mesh is not None:  # a skin places its mesh, whatever the node does
            places.setdefault(node.mesh, place if node.skin is None else np.eye(4))
            names[node.mesh] = names.get(node.mesh, ()) + _in_order(own)
    parts = [
        _part(gltf, document, (mesh, row), place, names[mesh])
        for mesh, place in places.items()
        for row, primitive in enumerate(document["meshes"][mesh]["primitives"])
        if primitive.get("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN)
    ]
    return Model(parts, GlbContent(gltf, text, bytes(rest)))


def _in_order(names: NodeNames) -> tuple[str, ...]:
    """Names of nodes, the topmost first."""
    found = list[str]()
    while names is not None:
        names, name = names
        found.append(name)
    return tuple(reversed(found))


def _part(
    gltf: Gltf,
    document: Json,
    place: tuple[int, int],
    matrix: Float[np.ndarray, "4 4"],
    names: tuple[str, ...],
) -> Part:
    mesh, row = place
    primitive = document["meshes"][mesh]["primitives"][row]
    attributes = primitive["attributes"]
    material = _material(document, primitive)

    def column(name: str, width: int) -> Float[np.ndarray, "V D"]:
        rows = gltf.fractions(attributes[name], name)
        if rows.shape[1] < width or len(rows) != len(points):
            raise ValueError(f"its {name} are {rows.shape}, for {len(points)} vertices")
        return rows[:, :width]

    points = gltf.fractions(attributes[POSITION], POSITION)
    points = column(POSITION, 3).astype(np.float64)
    if not np.isfinite(points).all():
        raise ValueError("some of its vertices are not finite")
    base = material.get("pbrMetallicRoughness", {})
    factors = np.tile(base.get("baseColorFactor", [1.0] * 4)[:3], (len(points), 1))
    if COLOR in attributes:
        factors = factors * column(COLOR, 3)
    info = base.get("baseColorTexture")
    uv_set = f"TEXCOORD_{_uv_set(info or {})}"
    uvs = column(uv_set, 2) if uv_set in attributes else None
    own = (document["meshes"][mesh].get("name"), material.get("name"))
    return Part(
        names=(*names, *filter(None, own)) or (f"mesh {mesh}",),
        vertices=points @ matrix[:3, :3].T + matrix[:3, 3],
        faces=_faces(gltf, primitive, len(points)),
        uvs=None if uvs is None else _transformed(uvs, info or {}),
        picture=_picture(gltf, document, info),
        factors=factors,
        texture=json.dumps(info, sort_keys=True) if info else (mesh, row),
        place=place,
    )


def _material(document: Json, primitive: Json) -> Json:
    return document["materials"][primitive["material"]] if "material" in primitive else {}


def _uv_set(info: Json) -> int:
    """The number of the UVs of a texture."""
    transform = info.get("extensions", {}).get(TRANSFORM, {})
    return transform.get("texCoord", info.get("texCoord", 0))


def _transformed(uvs: Float[np.ndarray, "V 2"], info: Json) -> Float[np.ndarray, "V 2"]:
    """UVs after KHR_texture_transform."""
    transform = info.get("extensions", {}).get(TRANSFORM)
    if transform is None:
        return uvs
    angle = transform.get("rotation", 0.0)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    scaled = uvs * transform.get("scale", [1.0, 1.0])
    return (scaled @ turn.T + transform.get("offset", [0.0, 0.0])).astype(np.float32)


def _faces(gltf: Gltf, primitive: Json, count: int) -> Int[np.ndarray, "F 3"]:
    """The corners of a primitive's triangles, strips and fans taken apart."""
    if "indices" in primitive:
        rows = gltf.stored(primitive["indices"], "indices")[:, 0].astype(np.int64)
    else:
        rows = np.arange(count)
    if len(rows) and not rows.max() < count:
        raise ValueError(f"a face has the corner {rows.max()} of {count} vertices")
    mode = primitive.get("mode", TRIANGLES)
    if mode == STRIP:
        corners = np.stack([rows[:-2], rows[1:-1], rows[2:]], axis=1)
        corners[1::2] = corners[1::2][:, [1, 0, 2]]
        return corners
    if mode == FAN:
        return np.stack([np.full(len(rows) - 2, rows[0]), rows[1:-1], rows[2:]], axis=1)
    return rows[: len(rows) // 3 * 3].reshape(-1, 3)


def _picture(gltf: Gltf, document: Json, info: Json | None) -> UInt8[np.ndarray, "H W 4"] | None:
    if info is None:
        return None
    image = _image(document, document["textures"][info["index"]])
    if "bufferView" in image:
        content = bytes(gltf.view(image["bufferView"], "a picture")[0])
    else:
        content = gltf.load_uri(image["uri"])
    return decode_embedded(content, gltf.path)


def _image(document: Json, texture: Json) -> Json:
    """The image of a texture, as WebP if that is the only one."""
    other = texture.get("extensions", {}).get(WEBP_TEXTURE, {}).get("source")
    return document["images"][texture.get("source", other)]


def painted_glb(
    model: Model,
    painted: Sequence[PaintedPart],
    pictures: Sequence[UInt8[np.ndarray, "S S 4"]],
    *,
    plain: bool = False,
) -> bytes:
    """A GLB whose painted parts have new base colours; all other bytes are as they were.

    With `plain` new UVs take the place of the first ones, and factors are spelled out, for programs
    that know no others.
    """
    content: GlbContent = model.content
    document, binary = json.loads(content.text), bytearray(content.gltf.binary or b"")
    document.setdefault("textures", [])
    textures, wanted = dict[tuple[Any, ...], int](), dict[tuple[int, int], Json]()
    for each in painted:
        mesh, row = each.part.place
        primitive = document["meshes"][mesh]["primitives"][row]
        primitive["attributes"].pop(COLOR, None)  # it is in the paint
        base = _material(document, primitive).get("pbrMetallicRoughness", {})
        info = base.get("baseColorTexture")
        before = document["textures"][info["index"]] if info else {}
        key = each.picture, before.get("sampler")
        if key not in textures:
            same = next((n for (number, _), n in textures.items() if number == each.picture), None)
            image = None if same is None else document["textures"][same]["source"]
            if image is None:
                image = _add_image(document, binary, before, pictures[each.picture])
            textures[key] = len(document["textures"])
            sampler = {"sampler": before["sampler"]} if "sampler" in before else {}
            document["textures"].append({"source": image, **sampler})
        wanted[mesh, row] = (info or {}) | {"index": textures[key]}
        if each.unwrapped is not None:
            uv_set = _rewrap(content.gltf, document, binary, primitive, each, plain=plain)
            wanted[mesh, row] = {"index": textures[key], "texCoord": uv_set}
    _set_materials(document, wanted, plain=plain)
    document["buffers"][0]["byteLength"] = len(binary)
    binary += bytes(-len(binary) % 4)
    head = bytearray(glb_head(padded_json(document), len(binary)))
    head[8:12] = (len(head) + len(binary) + len(content.rest)).to_bytes(4, "little")
    return bytes(head + binary) + content.rest


def _set_materials(document: Json, wanted: dict[tuple[int, int], Json], *, plain: bool) -> None:
    """Give primitives base colours; a material that others need as it is gets a copy."""
    primitives = {
        (mesh, row): primitive
        for mesh, each in enumerate(document["meshes"])
        for row, primitive in enumerate(each["primitives"])
    }
    materials, made = document.setdefault("materials", []), dict[tuple[Any, str], int]()
    for place, info in wanted.items():
        before = primitives[place].get("material")
        key = before, json.dumps(info, sort_keys=True)
        if key not in made:
            users = [each for each, p in primitives.items() if p.get("material") == before]
            alone = before is not None and all(wanted.get(each) == info for each in users)
            if not alone:
                materials.append({} if before is None else deepcopy(materials[before]))
            made[key] = before if alone and before is not None else len(materials) - 1
            base = materials[made[key]].setdefault("pbrMetallicRoughness", {})
            if before is None:
                base["metallicFactor"] = 0.0
            base["baseColorTexture"] = info
            if plain or "baseColorFactor" in base:
                alpha = base.get("baseColorFactor", [1.0] * 4)[3]
                base["baseColorFactor"] = [1.0, 1.0, 1.0, alpha]
        wanted[place] = {"material": made[key]}
    for place, found in wanted.items():
        primitives[place].update(found)


def _add_view(document: Json, binary: bytearray, content: bytes) -> int:
    """Append bytes, and return the number of their view."""
    binary += bytes(-len(binary) % 4)
    views = document.setdefault("bufferViews", [])
    views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(content)})
    binary += content
    return len(views) - 1


def _add_image(
    document: Json, binary: bytearray, before: Json, picture: UInt8[np.ndarray, "S S 4"]
) -> int:
    """Append a picture, in the format of the texture's before, and return its number."""
    kind = _image(document, before).get("mimeType") if before else PNG_TYPE
    kind = kind if kind == JPEG_TYPE and picture[..., 3].min() == 255 else PNG_TYPE
    content = picture_bytes(picture, "jpeg" if kind == JPEG_TYPE else "png")
    images = document.setdefault("images", [])
    images.append({"bufferView": _add_view(document, binary, content), "mimeType": kind})
    return len(images) - 1


def _rewrap(
    gltf: Gltf,
    document: Json,
    binary: bytearray,
    primitive: Json,
    painted: PaintedPart,
    *,
    plain: bool,
) -> int:
    """Give a primitive new UVs, a vertex more at each seam, and return the number of the UVs."""
    new = painted.unwrapped
    assert new is not None

    def gathered(attributes: Json) -> Json:
        return {
            name: _add_accessor(
                document,
                binary,
                gltf.stored(index, name)[new.origins],
                document["accessors"][index],
            )
            for name, index in attributes.items()
        }

    primitive["attributes"] = gathered(primitive["attributes"])
    if "targets" in primitive:
        primitive["targets"] = [gathered(target) for target in primitive["targets"]]
    known = sum(name.startswith("TEXCOORD_") for name in primitive["attributes"])
    number = 0 if plain else known
    uvs = _add_accessor(document, binary, new.uvs.astype("<f4"), {"componentType": GL_FLOAT})
    primitive["attributes"][f"TEXCOORD_{number}"] = uvs
    rows = new.faces.reshape(-1, 1).astype("<u4")
    primitive["indices"] = _add_accessor(document, binary, rows, {"componentType": GL_UINT32})
    primitive.pop("mode", None)
    return number


def _add_accessor(
    document: Json, binary: bytearray, rows: Shaped[np.ndarray, "U D"], like: Json
) -> int:
    """Append rows that are declared like those of another accessor."""
    width = rows.shape[1] * rows.itemsize
    stride = width + -width % 4  # as vertices demand
    padded = np.zeros((len(rows), stride), np.uint8)
    padded[:, :width] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), width)
    view = _add_view(document, binary, padded.tobytes())
    if stride != width:
        document["bufferViews"][view]["byteStride"] = stride
    kept = {key: like[key] for key in ("componentType", "normalized", "min", "max") if key in like}
    kind = {"bufferView": view, "count": len(rows), "type": GLB_KINDS[rows.shape[1]]}
    document["accessors"].append(kept | kind)
    return len(document["accessors"]) - 1
