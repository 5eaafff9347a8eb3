"""What lies at a path, and what to do with it where something else was asked for."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from stylesplat.errors import StyleSplatError, some
from stylesplat.io.files import is_there

HEIC = (".heic", ".heif", ".hif")
PHOTOS = (
    *(".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".tif", ".tiff", ".webp", ".avif"),
    *(".bmp", ".dib", ".gif", ".ppm", ".pgm", ".pnm", ".tga", *HEIC),
)
VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".3gp", ".mts", ".m2ts", ".mpg", ".wmv")
SPLATS = (
    *(".ply", ".spz", ".splat", ".sog", ".glb", ".gltf"),
    *(".usd", ".usdc", ".usda", ".usdz"),
)
SOG_META = "meta.json"  # of a SOG that is a folder

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


PICTURED = ("capture", "part of a capture", "photos", "video")  # what `train` makes scenes of


def kind_of(path: Path) -> Kind:
    """What lies there, by names: files are not opened."""
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


def no_scene(path: Path) -> StyleSplatError:
    """What to say of something that is given for a scene and is none."""
    kind = kind_of(path)
    if kind == "nothing":
        fault = f"There is no scene {path}: nothing has that name"
        return _told(fault, "Check it, or make a scene with `stylesplat train PHOTOS -o SCENE`")
    if kind == "part of a scene":
        return _told(f"{path} is a part of the scene {path.parent}", "Give the whole folder")
    if kind == "splat":
        return _told(f"{path} is a splat, not a scene", _way_to_import(path))
    if kind in PICTURED:
        return _told(f"{path} is {_called(kind)}, not a scene", _way_to_train(path, kind))
    held = _within(path, _is_scene)
    if held:
        return _told(
            f"{path} is not a scene, but holds some: {some(held, whole=True)}", "Give one of them"
        )
    fault = f"{path} is {_called(kind)}, not a scene"
    return _told(f"{fault}: it has no scene.json", "Give the folder that `train` or `import` made")


def no_capture(path: Path) -> StyleSplatError:
    """What to say of something that is given for a capture and is none."""
    kind = kind_of(path)
    if kind == "nothing":
        fault = f"There is no folder {path}: nothing has that name"
        return _told(fault, "Check it, or give the folder of the photos")
    if kind in ("scene", "part of a scene"):
        return _no_capture_but_scene(path if kind == "scene" else path.parent)
    if kind == "splat":
        return _told(f"{path} is a splat, not photos", _way_to_import(path))
    if kind == "part of a capture":
        fault = f"{path} holds the photos of the capture {path.parent}, whose poses are known"
        return _told(fault, "Give that folder")
    if kind in ("photos", "video"):
        fault = f"{path} is {_called(kind)}, not a capture: no camera poses are known"
        way = f"stylesplat sfm {shlex.quote(str(path))} -o CAPTURE"
        return _told(
            fault, f"Find the cameras first: `{way}`; or give the capture that was made of it"
        )
    if kind == "picture":
        return _told(f"{path} is one picture, not a capture", "Give the folder of all photos")
    if kind == "empty folder":
        fault = f"{path} is an empty folder, but photos are needed: at least 3, better 30 or more"
        return _told(fault, "Check the name, or put photos that overlap into it")
    held = _within(path, _is_capture)
    if held:
        return _told(
            f"{path} is not a capture, but holds some: {some(held, whole=True)}", "Give one of them"
        )
    needed = "sparse/0/cameras.bin (or .txt) nor transforms.json"
    fault = f"{path} is {_called(kind)}, not a capture: it has neither {needed}, nor photos"
    return _told(fault, "Check the name, or give the folder of the photos")


def no_splat(path: Path) -> StyleSplatError:
    """What to say of something that is given for a file of splats and is none."""
    kind = kind_of(path)
    if kind == "nothing":
        return _told(f"There is no file {path}", "Check the name")
    if kind in ("scene", "part of a scene"):
        scene = path if kind == "scene" else path.parent
        way = f"stylesplat objects {shlex.quote(str(scene))}"
        fault = f"{scene} is a scene already, not a file of splats"
        return _told(fault, f"Go on with it: `{way}` lists its objects")
    if kind in PICTURED:
        fault = f"{path} is {_called(kind)}, not a file of splats"
        return _told(fault, _way_to_train(path, kind))
    held = _within(path, lambda place: kind_of(place) == "splat")
    if held:
        return _told(
            f"{path} is a folder that holds {some(held, whole=True)}", "Give one of these files"
        )
    suffix = "" if path.is_dir() else f" with the suffix {path.suffix!r}"
    fault = f"{path} is {_called(kind)}{suffix}, not a file of splats"
    return _told(fault, f"Give one that ends in {', '.join(SPLATS)}, or convert it")


def refuse_other_than_photos(path: Path) -> None:
    """Refuse what poses cannot be found of, before anything is tried.

    Raises:
        StyleSplatError: If nothing is there or in there, or it is a scene, a part of one, or a
            splat.
    """
    if kind_of(path) in ("nothing", "empty folder", "scene", "part of a scene", "splat"):
        raise no_capture(path)


def _no_capture_but_scene(scene: Path) -> StyleSplatError:
    from stylesplat.io.scene_folder import capture_of, open
    from stylesplat.scene.framing import has_no_photos

    capture, fault = capture_of(scene), f"{scene} is a scene, not a capture"
    if capture is not None:
        return _told(f"{fault}, which has the photos", f"It was made from {capture}: give that")
    if not has_no_photos(open(scene)):
        way = f"stylesplat select {shlex.quote(str(scene))} --name NAME --box3d x0,y0,z0,x1,y1,z1"
        return _told(f"{fault}, and its photos are unknown", f"Name its objects by `{way}`")
    way = f"stylesplat mask {shlex.quote(str(scene))} --box NAME=VIEW:x0,y0,x1,y1"
    return _told(f"{fault}, and has no photos", f"Objects are cut out of its views by `{way}`")


def _kind_of_folder(path: Path) -> Kind:
    if _is_scene(path):
        return "scene"
    if _is_capture(path):
        return "capture"
    if _is_scene(path.parent):
        return "part of a scene"
    photos = any(_within(path, _holds_photos))
    if photos and path.name.startswith("images") and _is_capture(path.parent):
        return "part of a capture"
    if photos:
        return "photos"
    return "empty folder" if _is_empty(path) else "folder"


def _is_empty(folder: Path) -> bool:
    try:
        return not any(folder.iterdir())
    except OSError:  # nobody knows
        return False


def _is_scene(path: Path) -> bool:
    from stylesplat.io.scene_folder import SCENE

    return (path / SCENE).is_file()


def _is_capture(path: Path) -> bool:
    from stylesplat.io.captures.capture_folder import is_posed

    return is_posed(path)


def _holds_photos(path: Path) -> bool:
    """Whether it is a photo, or a folder that some lie in."""
    return _is_photo(path) or any(_within(path, _is_photo))


def _is_photo(path: Path) -> bool:
    return path.suffix.lower() in PHOTOS


def _within(path: Path, fits: Callable[[Path], bool]) -> list[Path]:
    """What in a folder fits, in order; nothing is in files."""
    try:
        return sorted(place for place in path.iterdir() if fits(place)) if path.is_dir() else []
    except OSError:
        return []


def _called(kind: Kind) -> str:
    named = {"photos": "a folder of photos", "part of a capture": "a folder of photos"}
    named |= {"empty folder": "an empty folder"}
    return named.get(kind, f"a {kind}")


def _way_to_train(path: Path, kind: Kind) -> str:
    source = path.parent if kind == "part of a capture" else path
    way = f"stylesplat train {shlex.quote(str(source))} -o {_scene_of(source)}"
    return f"A scene is made of it by `{way}`"


def _way_to_import(path: Path) -> str:
    way = f"stylesplat import {shlex.quote(str(path))} -o {_scene_of(path)}"
    return f"A scene is made of it by `{way}`"


def _scene_of(path: Path) -> str:
    """How the scene of something may be called."""
    return shlex.quote(f"{path.resolve().stem if path.is_file() else path.resolve().name}-scene")


def _told(fault: str, remedy: str) -> StyleSplatError:
    return StyleSplatError(f"{fault}. {remedy}.")
