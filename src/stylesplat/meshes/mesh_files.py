"""Textured meshes as files: glTF in one file (`.glb`), or Wavefront OBJ with its material."""

from pathlib import Path
from typing import Any

import numpy as np

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path, refuse_file, write_file
from stylesplat.io.images import picture_bytes
from stylesplat.io.splats.gltf import HALF_TURN, VERTICES, half_turned_node
from stylesplat.io.splats.gltf_file import GL_FLOAT, GL_UINT32, GLB_VERSION, glb_head, padded_json
from stylesplat.meshes.texture import TexturedMesh
from stylesplat.scene.world_offset import ORIGIN, Offset

SUFFIXES = (".glb", ".obj")
UNLIT = "KHR_materials_unlit"
INDICES = 34963  # the target of a view that holds indices
LINEAR, MIPMAPS = 9729, 9987  # filters of a texture: between texels, between its sizes
WORLD_DIGITS = 13  # millionths of millions
MATERIAL = "newmtl paint\nKd 1 1 1\nillum 0\nmap_Kd {}\n"  # illum 0: colours without light


def refuse_mesh_file(path: Path, *, overwrite: bool) -> None:
    """Refuse a name that no mesh can be written to."""
    if path.suffix.lower() not in SUFFIXES:
        raise StyleSplatError(
            f"Cannot write a mesh to {path}. Use a name in {' or '.join(SUFFIXES)}."
        )
    for file in (path, *_beside(path)):
        refuse_file(file, overwrite=overwrite)


def write_mesh(mesh: TexturedMesh, path: Path, offset: Offset = ORIGIN) -> None:
    """Write a mesh in the world, with y up: turned by half about z, as splats in a GLB."""
    if path.suffix.lower() == ".glb":
        write_file(path, _glb(mesh, offset))
        return
    material, picture = _beside(path)
    with atomic_path(path) as obj, atomic_path(material) as mtl, atomic_path(picture) as png:
        png.write_bytes(_png(mesh))
        mtl.write_text(MATERIAL.format(picture.name))
        obj.write_text(_obj(mesh, material.name, offset))


def _beside(path: Path) -> tuple[Path, ...]:
    """The material and the texture of an OBJ."""
    names = (".mtl", ".png") if path.suffix.lower() == ".obj" else ()
    return tuple(path.with_suffix(suffix) for suffix in names)


def _png(mesh: TexturedMesh) -> bytes:
    return picture_bytes(np.rint(mesh.texture.clip(0, 1) * 255).astype(np.uint8), "png")


def _obj(mesh: TexturedMesh, material: str, offset: Offset) -> str:
    uvs = np.stack([mesh.uvs[:, 0], 1 - mesh.uvs[:, 1]], axis=1)  # v is upwards
    lines = [f"mtllib {material}", "usemtl paint"]
    vertices, normals = (mesh.vertices + offset) @ HALF_TURN, mesh.normals @ HALF_TURN
    digits = 7 if offset == ORIGIN else WORLD_DIGITS
    for kind, rows, most in (("v", vertices, digits), ("vt", uvs, 7), ("vn", normals, 7)):
        lines += [
            f"{kind} " + " ".join(f"{value:.{most}g}" for value in row) for row in rows.tolist()
        ]
    corners = (" ".join(f"{n}/{n}/{n}" for n in row) for row in (mesh.faces + 1).tolist())
    lines += [f"f {row}" for row in corners]
    return "\n".join(lines) + "\n"


def _glb(mesh: TexturedMesh, offset: Offset) -> bytes:
    arrays = [np.ascontiguousarray(each, "<f4") for each in (mesh.vertices, mesh.normals, mesh.uvs)]
    arrays.append(np.ascontiguousarray(mesh.faces.reshape(-1), "<u4"))
    parts = [*(each.tobytes() for each in arrays), _png(mesh)]
    views, binary = list[dict[str, Any]](), b""
    for part, target in zip(parts, (VERTICES, VERTICES, VERTICES, INDICES, None), strict=True):
        view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(part)}
        views.append(view if target is None else view | {"target": target})
        binary += part + bytes(-len(part) % 4)
    kinds = ("VEC3", "VEC3", "VEC2", "SCALAR")
    accessors = [
        {
            "bufferView": number,
            "componentType": GL_UINT32 if kind == "SCALAR" else GL_FLOAT,
            "count": len(array),
            "type": kind,
        }
        for number, (array, kind) in enumerate(zip(arrays, kinds, strict=True))
    ]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    accessors[0] |= {"min": low.tolist(), "max": high.tolist()}
    document = {
        "asset": {"version": f"{GLB_VERSION}.0", "generator": "StyleSplat"},
        "extensionsUsed": [UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **half_turned_node(offset)}],
        "meshes": [
            {
                "primitives": [
                    {
                        "attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2},
                        "indices": 3,
                        "material": 0,
                    }
                ]
            }
        ],
        "materials": [
            {
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "metallicFactor": 0,
                    "roughnessFactor": 1,
                },
                "doubleSided": True,
                "extensions": {UNLIT: {}},
            }
        ],
        "textures": [{"sampler": 0, "source": 0}],
        "samplers": [{"magFilter": LINEAR, "minFilter": MIPMAPS}],
        "images": [{"bufferView": 4, "mimeType": "image/png"}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return glb_head(padded_json(document), len(binary)) + binary
