"""Meshes that others made: GLB, and what trimesh makes a GLB of (OBJ with its material, PLY)."""

from collections.abc import Sequence, Set
from contextlib import ExitStack
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from stylesplat.errors import StyleSplatError, join_names
from stylesplat.io.atomic import atomic_path, refuse_file
from stylesplat.io.files import is_there, read_bytes, reading
from stylesplat.io.images import picture_bytes
from stylesplat.io.models.glb import painted_glb, parse_glb
from stylesplat.io.models.model import Model, PaintedPart
from stylesplat.io.models.obj import (
    BASE_COLOR,
    MATERIALS,
    OBJ,
    file_beside,
    file_of_map,
    is_map,
    painted_obj,
    physically_based,
    read_obj,
)
from stylesplat.progress import say

GLB = ".glb"
CONVERTED = (OBJ, ".ply")
MODEL_SUFFIXES = (GLB, *CONVERTED)
MODEL_REMEDY = "Export it again as .glb."


def is_model(path: Path) -> bool:
    """Whether a path names a file of meshes, from its name alone."""
    return path.suffix.lower() in MODEL_SUFFIXES and not path.is_dir()


def refuse_model_file(source: Path, output: Path, *, overwrite: bool) -> None:
    """Refuse files that no mesh can be read from or written to, before any work."""
    if source.suffix.lower() not in MODEL_SUFFIXES:
        raise StyleSplatError(
            f"Cannot read {source} as a mesh. Give a {', '.join(MODEL_SUFFIXES)}."
        )
    if not is_there(source):
        raise StyleSplatError(f"There is no mesh {source}. Check the name.")
    kinds = (GLB, OBJ) if source.suffix.lower() in CONVERTED else (GLB,)
    if output.suffix.lower() not in kinds:
        fact = f"Cannot write the painted mesh of {source} to {output}"
        raise StyleSplatError(f"{fact}. Use a name in {' or '.join(kinds)}.")
    files = [output]
    if output.suffix.lower() == OBJ:
        files += [output.with_suffix(MATERIALS), *output.parent.glob(f"{output.stem}-*.png")]
    for file in files:
        refuse_file(file, overwrite=overwrite)


def read_model(path: Path) -> Model:
    """Read a file of meshes; a StyleSplatError if it has no faces."""
    with reading(path, MODEL_REMEDY, what=" as a mesh"):
        obj, left_out = None, frozenset[str]()
        if path.suffix.lower() == GLB:
            content = read_bytes(path)
        else:
            obj = read_obj(path) if path.suffix.lower() == OBJ else None
            content, left_out = _converted(path)
        model = parse_glb(path, content)
        parts = [part for part in model.parts if len(part.faces)]
        if not parts:
            raise ValueError("it has no faces")
        return Model(parts, model.content, obj, left_out)


def write_model(
    model: Model,
    painted: Sequence[PaintedPart],
    pictures: Sequence[UInt8[np.ndarray, "S S 4"]],
    path: Path,
) -> None:
    """Write a mesh with the new base colours of its painted parts.

    An OBJ gets its materials and pictures beside it, by names that begin as its own. If it was made
    of an OBJ, and the painted parts keep their UVs, only the base colours of its text change.
    """
    if path.suffix.lower() == GLB:
        _say_left_out(path, model.left_out)
        with atomic_path(path) as draft:
            draft.write_bytes(painted_glb(model, painted, pictures))
        return
    named = {each.part.names[-1]: each.picture for each in painted}
    keeps_uvs = all(each.unwrapped is None for each in painted)
    if model.obj is not None and keeps_uvs and model.obj.can_keep({*named}):
        own = [f"{path.stem}-paint-{number}.png" for number in range(len(pictures))]
        text, materials, copies = painted_obj(
            model.obj, {name: own[number] for name, number in named.items()}, path
        )
        files = {name: source.read_bytes() for name, source in copies.items()}
        files |= {
            name: picture_bytes(each, "png") for name, each in zip(own, pictures, strict=True)
        }
    else:
        if model.obj is not None:
            _say_left_out(path, {kind for _, kind, _ in model.obj.maps()} - {BASE_COLOR})
        text, materials, files = _spelled_out(
            painted_glb(model, painted, pictures, plain=True), path
        )
    with ExitStack() as stack:
        files |= {path.with_suffix(MATERIALS).name: materials, path.name: text}
        for name, content in files.items():
            stack.enter_context(atomic_path(path.with_name(name))).write_bytes(content)


def _spelled_out(content: bytes, path: Path) -> tuple[bytes, bytes, dict[str, bytes]]:
    """A GLB as the text of an OBJ, that of its materials, and its pictures by name."""
    import trimesh
    from trimesh.exchange.obj import export_obj

    materials = path.with_suffix(MATERIALS).name
    text, files = export_obj(
        trimesh.load_scene(BytesIO(content), file_type="glb"),
        include_normals=True,
        return_texture=True,
        mtl_name=materials,
    )
    named, pictures = files.pop(materials).decode(), dict[str, bytes]()
    for name, picture in files.items():
        own = f"{path.stem}-{name}"
        named = named.replace(f"map_Kd {name}", f"map_Kd {own}")
        pictures[own] = picture
    return text.encode(), named.encode(), pictures


def _say_left_out(path: Path, kinds: Set[str]) -> None:
    if kinds:
        remedy = "" if path.suffix.lower() == GLB else " Paint to a .glb to keep more of them."
        say(f"{path} is without the maps {join_names(sorted(kinds))} of its materials.{remedy}")


def _converted(path: Path) -> tuple[bytes, frozenset[str]]:
    """The bytes of a GLB of an OBJ or PLY, and the kinds of maps that are not in it."""
    if find_spec("trimesh") is None:
        raise StyleSplatError(
            f"Reading {path} as a mesh needs trimesh. Run `pip install 'stylesplat[mesh]'`, or "
            "save it as .glb."
        )
    import trimesh
    from trimesh.resolvers import FilePathResolver
    from trimesh.visual.material import SimpleMaterial

    class Beside(FilePathResolver):
        """Materials and pictures of the file's own folder alone."""

        def get(self, name: str) -> bytes:
            found = file_beside(path, file_of_map(name))
            if found is None:
                raise FileNotFoundError(name)
            return read_bytes(found)

    scene = trimesh.load_scene(path, process=False, resolver=Beside(str(path)))
    meshes = {
        name: each
        for name, each in scene.geometry.items()
        if isinstance(each, trimesh.Trimesh) and len(each.faces)
    }
    if not meshes:
        raise ValueError("it has no faces")
    left_out = set[str]()
    for mesh in meshes.values():
        visual: Any = mesh.visual
        material = getattr(visual, "material", None)
        if isinstance(material, SimpleMaterial):
            visual.material, kept = physically_based(material, path)
            left_out |= {key for key in material.kwargs if is_map(key)} - kept
    content = trimesh.Scene(meshes).export(file_type="glb")
    assert isinstance(content, bytes)
    return content, frozenset(left_out)
