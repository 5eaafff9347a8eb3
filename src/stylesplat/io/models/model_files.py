"""Meshes that others made: GLB, and what trimesh makes a GLB of (OBJ with its material, PLY)."""

import itertools
import re
from collections.abc import Callable, Sequence, Set
from contextlib import ExitStack
from dataclasses import replace
from importlib.util import find_spec
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from stylesplat.errors import StyleSplatError, join_names
from stylesplat.io.atomic import atomic_path, refuse_file, write_file
from stylesplat.io.files import is_there, read_bytes, reading
from stylesplat.io.images import open_image, picture_bytes
from stylesplat.io.kinds import kind_of
from stylesplat.io.models.glb import SPLATS_FOUND, painted_glb, parse_glb
from stylesplat.io.models.model import Model, PaintedPart
from stylesplat.io.models.obj import (
    BASE_COLOR,
    MERGED,
    OBJ,
    OBJ_MATERIALS,
    Obj,
    beside,
    file_beside,
    file_of_map,
    is_map,
    painted_obj,
    physically_based,
    read_obj,
    text_for_readers,
)
from stylesplat.progress import say

GLB, GLTF = ".glb", ".gltf"
SPLAT_COLUMNS = re.compile(rb"^property \w+ (f_dc_0|packed_position)\s", re.MULTILINE)
HEADER_BYTES = 1 << 16  # of a PLY, at most: its columns are among them
CONVERTED = (OBJ, ".ply")
MODEL_SUFFIXES = (GLB, *CONVERTED)
MODEL_REMEDY = "Export it again as .glb."


def is_model(path: Path) -> bool:
    """Whether a path names a file of meshes, or one that is nothing else, from its name alone."""
    is_named_so = path.suffix.lower() in (*MODEL_SUFFIXES, GLTF) and not path.is_dir()
    return is_named_so or kind_of(path) == "file"


def refuse_model_file(source: Path, output: Path, *, overwrite: bool) -> None:
    """Refuse files that no mesh can be read from or written to, before any work."""
    if source.suffix.lower() not in MODEL_SUFFIXES:
        raise StyleSplatError(
            f"Cannot read {source} as a mesh. Give a {', '.join(MODEL_SUFFIXES)}; of splats "
            "`stylesplat import` makes a scene to paint."
        )
    if not is_there(source):
        raise StyleSplatError(f"There is no mesh {source}. Check the name.")
    kinds = (GLB, OBJ) if source.suffix.lower() in CONVERTED else (GLB,)
    if output.suffix.lower() not in kinds:
        fact = f"Cannot write the painted mesh of {source} to {output}"
        raise StyleSplatError(f"{fact}. Use a name in {' or '.join(kinds)}.")
    refuse_file(output, overwrite=overwrite)
    if output.suffix.lower() == OBJ:
        refuse_file(output.with_suffix(OBJ_MATERIALS), overwrite=overwrite)


def read_model(path: Path) -> Model:
    """Read a file of meshes; a StyleSplatError if it has no faces."""
    with reading(path, MODEL_REMEDY, what=" as a mesh"):
        obj, left_out = None, frozenset[str]()
        if path.suffix.lower() == GLB:
            content = read_bytes(path)
        else:
            obj = read_obj(path) if path.suffix.lower() == OBJ else None
            if obj is None and SPLAT_COLUMNS.search(read_bytes(path, first=HEADER_BYTES)):
                raise ValueError(SPLATS_FOUND)
            content, left_out = _converted(path, obj)
        model = parse_glb(path, content)
        parts = [part for part in model.parts if len(part.faces)]
        if obj is not None:  # faces of one material are one mesh, whatever their groups
            parts = [replace(part, names=part.names[-1:]) for part in parts]
        if not parts:
            raise ValueError("it has no faces")
        return Model(parts, model.content, obj, left_out)


def write_model(
    model: Model,
    painted: Sequence[PaintedPart],
    pictures: Sequence[UInt8[np.ndarray, "S S 4"]],
    path: Path,
    *,
    overwrite: bool = False,
) -> None:
    """Write a mesh with the new base colours of its painted parts.

    An OBJ gets its materials and pictures beside it, by names that begin as its own and are not
    those of files that its source uses. If it was made of an OBJ, and the painted parts keep their
    UVs, only the base colours of its text change.
    """
    if path.suffix.lower() == GLB:
        _say_left_out(path, model.left_out)
        write_file(path, painted_glb(model, painted, pictures))
        return
    obj, name_of = model.obj, _naming(model.obj, path, overwrite=overwrite)
    library = path.with_suffix(OBJ_MATERIALS).name
    if obj is not None and obj.path.resolve() != path.resolve():
        if path.with_name(library).resolve() in {each.resolve() for each in obj.libraries}:
            library = name_of(f"materials{OBJ_MATERIALS}")
    named = {each.part.names[-1]: each.picture for each in painted}
    keeps_uvs = all(each.unwrapped is None for each in painted)
    if obj is not None and keeps_uvs and obj.can_keep({*named}):
        own = [name_of(f"paint-{number}.png") for number in range(len(pictures))]
        by_material = {name: own[number] for name, number in named.items()}
        text, materials, copies = painted_obj(obj, by_material, path, library, name_of)
        files = {name: source.read_bytes() for name, source in copies.items()}
        files |= {
            name: picture_bytes(each, "png") for name, each in zip(own, pictures, strict=True)
        }
    else:
        if obj is not None:
            _say_left_out(path, {kind for _, kind, _ in obj.maps()} - {BASE_COLOR})
        content = painted_glb(model, painted, pictures, plain=True)
        text, materials, files = _spelled_out(content, library, name_of)
    with ExitStack() as stack:
        # Renamed from the last to the first: nothing names a file that is not there yet
        for name, content in ({path.name: text, library: materials} | files).items():
            stack.enter_context(atomic_path(path.with_name(name))).write_bytes(content)


def _naming(obj: Obj | None, path: Path, *, overwrite: bool) -> Callable[[str], str]:
    """Makes names beside an output, none of which is that of a file to keep."""
    kept = {each.resolve() for each in (() if obj is None else obj.files())}
    taken = set[str]()

    def name_of(file: str) -> str:
        flat = Path(re.sub(r"[/\\]", "-", file))
        for number in itertools.count(1):
            counted = f"-{number}" if number > 1 else ""
            name = f"{path.stem}-{flat.stem}{counted}{flat.suffix}"
            place = path.with_name(name)
            is_other = place.resolve() in kept or (is_there(place) and not overwrite)
            if not is_other and name.lower() not in taken:
                taken.add(name.lower())
                return name
        raise AssertionError

    return name_of


def _spelled_out(
    content: bytes, library: str, name_of: Callable[[str], str]
) -> tuple[bytes, bytes, dict[str, bytes]]:
    """A GLB as the text of an OBJ, that of its materials, and its pictures by name."""
    import trimesh
    from trimesh.exchange.obj import export_obj

    text, files = export_obj(
        trimesh.load_scene(BytesIO(content), file_type="glb"),
        include_normals=True,
        return_texture=True,
        mtl_name=library,
    )
    materials = files.pop(library).decode()
    own = {name: name_of(name) for name in files}
    materials = re.sub("(?m)^map_Kd (.*)$", lambda found: f"map_Kd {own[found[1]]}", materials)
    return text.encode(), materials.encode(), {own[name]: each for name, each in files.items()}


def _say_left_out(path: Path, kinds: Set[str]) -> None:
    if kinds:
        remedy = "" if path.suffix.lower() == GLB else " Paint to a .glb to keep more of them."
        say(f"{path} is without the maps {join_names(sorted(kinds))} of its materials.{remedy}")


def _converted(path: Path, obj: Obj | None) -> tuple[bytes, frozenset[str]]:
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
            if obj is not None and name == MERGED:
                return obj.materials.encode()
            found = file_beside(path, file_of_map(name))
            if found is None:
                raise FileNotFoundError(name)
            return read_bytes(found)

    for _, kind, name in () if obj is None else obj.maps():
        if kind == BASE_COLOR and (picture := beside(path, name)) is not None:
            with open_image(picture):  # a damaged one trimesh would leave out without a word
                pass
    resolver, text = Beside(str(path)), None if obj is None else StringIO(text_for_readers(obj))
    kind = path.suffix.lower().removeprefix(".")
    scene = trimesh.load_scene(text or path, file_type=kind, process=False, resolver=resolver)
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
