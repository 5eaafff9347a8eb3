"""What lies at a path, and what to do with it where something else was expected."""

import os
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from stylesplat.errors import StyleSplatError, some
from stylesplat.io.files import is_file, is_there
from stylesplat.io.json_files import read_json

HEIC = (".heic", ".heif", ".hif")
PHOTOS = (
    *(".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".tif", ".tiff", ".webp", ".avif"),
    *(".bmp", ".dib", ".gif", ".ppm", ".pgm", ".pnm", ".tga", *HEIC),
)
VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".3gp", ".mts", ".m2ts", ".mpg", ".wmv")
SPLATS = (".ply", ".spz", ".splat", ".ksplat", ".sog", ".glb", ".gltf")
SOG_META = "meta.json"  # of a SOG that is a folder
SCENE = "scene.json"  # makes a folder a scene
CAMERAS = "cameras.json"  # of a scene
TRANSFORMS = "transforms.json"  # makes a folder a capture, as COLMAP's files do

Kind = Literal[
    "nothing",
    "scene",
    "part of a scene",
    "capture",
    "part of a capture",
    "photos",
    "video",
    "splat",
    "picture",
    "file",
    "folder",
    "empty folder",
]
TRAINABLE = ("capture", "part of a capture", "photos", "video")


def kind_of(path: Path) -> Kind:
    """What lies at a path, from names alone: no file is opened."""
    if not is_there(path):
        return "nothing"
    if path.is_dir():
        return _kind_of_folder(path)
    if _is_scene(path.parent):
        return "part of a scene"
    suffix = path.suffix.lower()
    if suffix in SPLATS or path.name == SOG_META:
        return "splat"
    if suffix in VIDEOS:
        return "video"
    return "picture" if suffix in PHOTOS else "file"


def is_posed(folder: Path) -> bool:
    return find_sparse(folder) is not None or is_file(folder / TRANSFORMS)


def find_sparse(folder: Path) -> Path | None:
    """The folder with the COLMAP reconstruction of a capture, if it has one."""
    for sparse in (folder / "sparse" / "0", folder / "sparse"):
        if any(is_file(sparse / f"cameras{suffix}") for suffix in (".bin", ".txt")):
            return sparse
    return None


def find_capture(scene: Path, capture: str | None, relative: str | None) -> Path | None:
    """The capture of a scene: where it was, or beside the scene if both were moved together."""
    if capture is None:
        return None
    before = Path(capture)
    if relative is None or before.is_dir():
        return before
    moved = Path(os.path.normpath(scene.resolve() / relative))
    return moved if moved.is_dir() else before


def no_scene(path: Path) -> StyleSplatError:
    """The error for a path that should be a scene and is none."""
    kind = kind_of(path)
    if kind == "nothing":
        fault = f"There is no scene {path}: nothing has that name"
        return _error(fault, "Check it, or make a scene with `stylesplat train PHOTOS -o SCENE`")
    if kind == "part of a scene":
        return _error(f"{path} is a part of the scene {path.parent}", "Give the whole folder")
    if kind == "splat" or kind in TRAINABLE:
        return _error(f"{path} is {_article(kind)}, not a scene", _way_to_scene(path, kind))
    remedy = "Give the folder that `train` or `import` made"
    return _other(path, "scene", _is_scene, "it has no scene.json", remedy)


def no_capture(path: Path) -> StyleSplatError:
    """The error for a path that should be a capture and is none."""
    kind = kind_of(path)
    match kind:
        case "nothing":
            fault = f"There is no folder {path}: nothing has that name"
            return _error(fault, "Check it, or give the folder of the photos")
        case "scene" | "part of a scene":
            return _scene_for_capture(path if kind == "scene" else path.parent)
        case "splat":
            return _error(f"{path} is a splat, not photos", _way_to_scene(path, kind))
        case "part of a capture":
            fault = f"{path} holds the photos of the capture {path.parent}, whose poses are known"
            return _error(fault, "Give that folder")
        case "photos" | "video":
            fault = f"{path} is {_article(kind)}, not a capture: no camera poses are known"
            way = f"Find the cameras first: `stylesplat sfm {shlex.quote(str(path))} -o CAPTURE`"
            return _error(fault, f"{way}; or give the capture that was made of it")
        case "picture":
            return _error(f"{path} is one picture, not a capture", "Give the folder of all photos")
        case "empty folder":
            fault = f"{path} is an empty folder, but photos are needed: at least 3, better 30"
            return _error(f"{fault} or more", "Check the name, or put photos that overlap into it")
    why = "it has neither sparse/0/cameras.bin (or .txt) nor transforms.json, nor photos"
    remedy = "Check the name, or give the folder of the photos"
    return _other(path, "capture", is_posed, why, remedy)


def no_splat(path: Path) -> StyleSplatError:
    """The error for a path that should be a file of splats and is none."""
    kind = kind_of(path)
    if kind == "nothing":
        return _error(f"There is no file {path}", "Check the name")
    if kind in ("scene", "part of a scene"):
        scene = path if kind == "scene" else path.parent
        way = f"`stylesplat objects {shlex.quote(str(scene))}` lists its objects"
        return _error(f"{scene} is a scene already, not a file of splats", f"Go on with it: {way}")
    if kind in TRAINABLE:
        fault = f"{path} is {_article(kind)}, not a file of splats"
        return _error(fault, _way_to_scene(path, kind))
    inner = _entries(path, lambda entry: kind_of(entry) == "splat")
    if inner:
        fault = f"{path} is a folder that holds {some(inner, whole=True)}"
        return _error(fault, "Give one of these files")
    suffix = "" if path.is_dir() else f" with the suffix {path.suffix!r}"
    fault = f"{path} is {_article(kind)}{suffix}, not a file of splats"
    return _error(fault, f"Give one that ends in {', '.join(SPLATS)}, or convert it")


def refuse_other_than_photos(path: Path) -> None:
    """Raise a StyleSplatError for a path that holds nothing to find poses of."""
    if kind_of(path) in ("nothing", "empty folder", "scene", "part of a scene", "splat"):
        raise no_capture(path)


def _scene_for_capture(scene: Path) -> StyleSplatError:
    content, fault = read_json(scene / SCENE), f"{scene} is a scene, not a capture"
    capture = find_capture(scene, content.get("capture"), content.get("capture_relative"))
    if capture is not None:
        return _error(f"{fault}, which has the photos", f"It was made from {capture}: give that")
    name = shlex.quote(str(scene))
    ways = (
        f"`stylesplat select {name} --name NAME --box3d x0,y0,z0,x1,y1,z1`, or cut them out of its "
        f"views by `stylesplat mask {name} --box NAME=VIEW:x0,y0,x1,y1`"
    )
    return _error(f"{fault}, and its photos are unknown", f"Name its objects by {ways}")


def _other(
    path: Path, wanted: str, fits: Callable[[Path], bool], why: str, remedy: str
) -> StyleSplatError:
    """The error for a path that is not what is wanted, but perhaps a folder of such things."""
    inner = _entries(path, fits)
    if inner:
        fault = f"{path} is not a {wanted}, but holds some: {some(inner, whole=True)}"
        return _error(fault, "Give one of them")
    return _error(f"{path} is {_article(kind_of(path))}, not a {wanted}: {why}", remedy)


def _kind_of_folder(path: Path) -> Kind:
    if _is_scene(path):
        return "scene"
    if is_posed(path):
        return "capture"
    if _is_scene(path.parent):
        return "part of a scene"
    photos = any(_entries(path, lambda p: _is_photo(p) or any(_entries(p, _is_photo))))
    if photos and path.name.startswith("images") and is_posed(path.parent):
        return "part of a capture"
    if photos:
        return "photos"
    try:
        return "folder" if any(path.iterdir()) else "empty folder"
    except OSError:  # this user may not read it
        return "folder"


def _is_scene(path: Path) -> bool:
    return (path / SCENE).is_file()


def _is_photo(path: Path) -> bool:
    return path.suffix.lower() in PHOTOS


def _entries(path: Path, fits: Callable[[Path], bool]) -> list[Path]:
    """The entries of a folder that fit, sorted; none if the path is no readable folder."""
    try:
        return sorted(entry for entry in path.iterdir() if fits(entry)) if path.is_dir() else []
    except OSError:
        return []


def _article(kind: Kind) -> str:
    if kind in ("photos", "part of a capture"):
        return "a folder of photos"
    return "an empty folder" if kind == "empty folder" else f"a {kind}"


def _way_to_scene(path: Path, kind: Kind) -> str:
    source = path.parent if kind == "part of a capture" else path
    name = source.resolve().stem if source.is_file() else source.resolve().name
    verb = "import" if kind == "splat" else "train"
    command = f"stylesplat {verb} {shlex.quote(str(source))} -o {shlex.quote(f'{name}-scene')}"
    return f"A scene is made of it by `{command}`"


def _error(fault: str, remedy: str) -> StyleSplatError:
    return StyleSplatError(f"{fault}. {remedy}.")
