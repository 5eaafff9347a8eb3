"""Meshes that others made: GLB, and what trimesh makes a GLB of (OBJ with its material, PLY)."""

import re
from collections.abc import Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from stylesplat.errors import StyleSplatError, join_names, shorten
from stylesplat.io.atomic import atomic_path, refuse_file
from stylesplat.io.files import is_there, read_bytes, reading, resolve_within
from stylesplat.io.models.glb import painted_glb, parse_glb
from stylesplat.io.models.model import Model, PaintedPart
from stylesplat.progress import say

GLB, OBJ, MATERIALS = ".glb", ".obj", ".mtl"
CONVERTED = (OBJ, ".ply")
MODEL_SUFFIXES = (GLB, *CONVERTED)
OTHER_MAPS = re.compile(rb"^\s*(map_(?!Kd\b)\w+|bump|norm|disp|decal|refl)\b", re.MULTILINE)
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
        is_glb = path.suffix.lower() == GLB
        model = parse_glb(path, read_bytes(path) if is_glb else _converted(path))
        parts = [part for part in model.parts if len(part.faces)]
        if not parts:
            raise ValueError("it has no faces")
        return Model(parts, model.content)


def write_model(
    model: Model,
    painted: Sequence[PaintedPart],
    pictures: Sequence[UInt8[np.ndarray, "S S 4"]],
    path: Path,
) -> None:
    """Write a mesh with the new base colours of its painted parts.

    An OBJ gets its materials and pictures beside it, by names that begin as its own.
    """
    if path.suffix.lower() == GLB:
        with atomic_path(path) as draft:
            draft.write_bytes(painted_glb(model, painted, pictures))
        return
    import trimesh
    from trimesh.exchange.obj import export_obj

    content = BytesIO(painted_glb(model, painted, pictures, plain=True))
    materials = path.with_suffix(MATERIALS)
    text, files = export_obj(
        trimesh.load_scene(content, file_type="glb"),
        include_normals=True,
        return_texture=True,
        mtl_name=materials.name,
    )
    named = files.pop(materials.name).decode()
    with ExitStack() as stack:
        for name, picture in files.items():
            own = f"{path.stem}-{name}"
            named = named.replace(f"map_Kd {name}", f"map_Kd {own}")
            stack.enter_context(atomic_path(path.with_name(own))).write_bytes(picture)
        stack.enter_context(atomic_path(materials)).write_text(named)
        stack.enter_context(atomic_path(path)).write_text(text)


def _converted(path: Path) -> bytes:
    """The bytes of a GLB of an OBJ or PLY; points without faces are none."""
    if find_spec("trimesh") is None:
        raise StyleSplatError(
            f"Reading {path} as a mesh needs trimesh. Run `pip install 'stylesplat[mesh]'`, or "
            "save it as .glb."
        )
    import trimesh
    from trimesh.resolvers import FilePathResolver

    class Beside(FilePathResolver):
        """Materials and pictures of the file's own folder alone."""

        def get(self, name: str) -> bytes:
            try:
                resolve_within(path.parent, name)
            except StyleSplatError as error:
                say(f"{path} names {shorten(name)!r}, which is outside its folder: left out.")
                raise FileNotFoundError(name) from error
            content = super().get(name)
            left = sorted({each.decode() for each in OTHER_MAPS.findall(content)})
            if name.lower().endswith(MATERIALS) and left:
                say(
                    f"{name}: {join_names(left)} will not be in the painted mesh, which has base "
                    "colours alone. Paint a .glb to keep them."
                )
            return content

    scene = trimesh.load_scene(path, process=False, resolver=Beside(str(path)))
    meshes = {
        name: each
        for name, each in scene.geometry.items()
        if isinstance(each, trimesh.Trimesh) and len(each.faces)
    }
    if not meshes:
        raise ValueError("it has no faces")
    content = trimesh.Scene(meshes).export(file_type="glb")
    assert isinstance(content, bytes)
    return content
