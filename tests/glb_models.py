"""A GLB of meshes, as an artist's program writes it."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from scenes import glb_of


def png(color: tuple[int, ...], size: int = 8) -> bytes:
    file = io.BytesIO()
    mode = "RGBA" if len(color) == 4 else "RGB"
    Image.new(mode, (size, size), color).save(file, "png")
    return file.getvalue()


def sphere_arrays(radius: float, x: float) -> dict[str, np.ndarray]:
    """A ball of few faces around (x, 0, 0), with UVs of one place each."""
    ball = trimesh.creation.uv_sphere(radius=radius, count=[12, 12])
    points = np.asarray(ball.vertices, np.float32)
    corners = points[ball.faces.reshape(-1)]  # each face has its own place in the texture
    side = int(np.ceil(np.sqrt(len(ball.faces))))
    cells = np.stack(np.divmod(np.arange(len(ball.faces)), side), axis=1)
    local = np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]])
    uvs = ((cells[:, None] + local) / side).reshape(-1, 2).astype(np.float32)
    normals = corners / radius
    return {
        "POSITION": corners + np.array([x, 0, 0], np.float32),
        "NORMAL": normals,
        "TEXCOORD_0": uvs,
    }


def write_model_glb(folder: Path, *, shared_uvs: bool = False) -> Path:
    """Two balls: a red one with a normal map, and a green one with bones and a morph target."""
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "extras": {"kept": [1.5]}},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [
            {"name": "left", "mesh": 0, "scale": [2, 2, 2]},
            {"name": "right", "mesh": 1, "skin": 0, "extras": {"kept": True}},
        ],
        "skins": [{"joints": [0, 1]}],
        "meshes": [],
        "accessors": [],
        "bufferViews": [],
        "buffers": [{}],
        "images": [{"bufferView": n, "mimeType": "image/png"} for n in range(2)],
        "samplers": [{"wrapS": 33071}],
        "textures": [{"source": 0, "sampler": 0}, {"source": 1}],
        "materials": [
            {
                "name": "red paint",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "roughnessFactor": 0.4},
                "normalTexture": {"index": 1},
            },
            {
                "name": "green paint",
                "pbrMetallicRoughness": {"baseColorFactor": [0.0, 1.0, 0.0, 1.0]},
            },
        ],
        "extensionsUsed": ["EXT_unknown"],
        "extensions": {"EXT_unknown": {"kept": "\u00e4"}},
    }
    binary = bytearray()

    def view(content: bytes) -> int:
        binary.extend(bytes(-len(binary) % 4))
        views = document["bufferViews"]
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(content)})
        binary.extend(content)
        return len(views) - 1

    def add(rows: np.ndarray) -> int:
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[rows.shape[1]]
        accessor = {"componentType": {"f": 5126, "u": 5121}[rows.dtype.kind], "type": kind}
        accessor |= {"bufferView": view(rows.tobytes()), "count": len(rows)}
        document["accessors"].append(accessor)
        return len(document["accessors"]) - 1

    view(png((255, 0, 0)))
    view(png((128, 128, 255)))
    for number in range(2):
        attributes = {}
        for name, rows in sphere_arrays(0.5, 2.0 * number).items():
            if shared_uvs and name == "TEXCOORD_0":
                rows = 0.1 * rows % 0.02
            attributes[name] = add(rows.astype("<f4"))
        primitive: dict[str, Any] = {"attributes": attributes, "material": number}
        if number == 1:
            points = np.arange(document["accessors"][-1]["count"])
            attributes["JOINTS_0"] = add((points[:, None] % [2, 3, 5, 7]).astype("u1"))
            attributes["WEIGHTS_0"] = add(np.eye(4, dtype="<f4")[points % 4])
            primitive["targets"] = [{"POSITION": add((points[:, None] * [1, 2, 3]).astype("<f4"))}]
            del attributes["TEXCOORD_0"]
        document["meshes"].append({"name": f"ball {number}", "primitives": [primitive]})
    document["buffers"][0]["byteLength"] = len(binary)
    path = folder / "model.glb"
    path.write_bytes(glb_of(document, bytes(binary)))
    return path
