"""What lies at a path, and what to do with it where something else was expected."""

import os
from collections.abc import Callable, Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Literal, NamedTuple

from stylesplat.errors import StyleSplatError, join_names, shell_command
from stylesplat.io.files import is_file, is_folder, is_there
from stylesplat.io.json_yaml import read_json

HEIC = (".heic", ".heif", ".hif")
PHOTOS = (
    *(".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".tif", ".tiff", ".webp", ".avif"),
    *(".bmp", ".dib", ".gif", ".ppm", ".pgm", ".pnm", ".tga", *HEIC),
)
VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".3gp", ".mts", ".m2ts", ".mpg", ".wmv")
USD = (".usd", ".usda", ".usdc", ".usdz")
CHECKPOINTS = (".pt", ".ckpt")  # of gsplat and nerfstudio
SPLATS = (".ply", ".spz", ".splat", ".ksplat", ".sog", ".glb", ".gltf", *USD, *CHECKPOINTS)
SOG_META = "meta.json"  # of a SOG that is a folder
SOG_LEVELS = "lod-meta.json"  # of a streamed SOG
SOG_JSONS = (SOG_META, SOG_LEVELS)
SOG_MEANS = "means_l.webp"  # a picture of each SOG that is a folder
SCENE = "scene.json"  # makes a folder a scene
CAMERAS = "cameras.json"  # of a scene
TRANSFORMS = "transforms.json"  # makes a folder a capture, as COLMAP's files do
SPLITS = ("train", "test", "val")  # of NeRF-synthetic, BlenderNeRF and nerfstudio
SPLIT_TRANSFORMS = tuple(f"transforms_{split}.json" for split in SPLITS)
POSES_BOUNDS = "poses_bounds.npy"  # of LLFF
# Folders of pictures that are no photos of the scene
NO_PHOTOS = (
    *("object_mask", "object_mask_exact", "object_masks", "mask", "masks"),
    *("sparse", "depth", "depths", "thumbs"),
)
PHOTO_FOLDERS = ("images", "input")  # how the names of folders begin that lie beside their poses

Form = Literal["colmap", "transforms", "llff"]
# Where a capture keeps its poses, the places to prefer first: files, or folders of COLMAP models
POSES: tuple[tuple[Form, tuple[str, ...]], ...] = (
    ("colmap", ("sparse/*",)),
    ("colmap", ("sparse",)),
    ("transforms", (TRANSFORMS,)),
    ("transforms", SPLIT_TRANSFORMS),
    ("colmap", ("colmap/sparse/*",)),  # nerfstudio
    ("colmap", ("colmap/sparse",)),
    ("colmap", ("colmap",)),
    ("colmap", ("dense/*/sparse",)),  # COLMAP's automatic reconstructor
    ("colmap", ("dense/sparse",)),
    ("colmap", ("distorted/sparse/*",)),  # INRIA's convert.py
    ("colmap", ("distorted/sparse",)),
    ("colmap", (".", "images")),  # beside the photos
    ("llff", (POSES_BOUNDS,)),
)
# Files of poses that are not read, beside or among photos
FOREIGN_POSES = (
    *("cameras.json", "transforms*.json"),  # INRIA; NeRF
    *("*camera*.xml", "*blocks*.xml"),  # Metashape; ContextCapture
    *("bundle*.out", "*.nvm", "*.sfm"),  # Bundler; VisualSFM; Meshroom
    *("sfm_data*.json", "sfm_data*.bin", "reconstruction.json"),  # OpenMVG; OpenSfM
    *("*poses*.txt", "*.pose.txt", "*traj*.txt", "groundtruth.txt"),  # KITTI; 7-Scenes; TUM
    *("*_sfm.log", "trajectory.log", "*_cam.txt"),  # Tanks and Temples; Open3D; MVSNet
    *("cameras*.npz", "*poses*.npy", "*poses*.npz"),  # IDR; LLFF
)
FOREIGN_DEPTH = 2  # folders below that are searched for them

FileKind = Literal[
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


def kind_of(path: Path) -> FileKind:
    """What lies at a path, from names alone: no file is opened."""
    if not is_there(path):
        return "nothing"
    if path.is_dir():
        return _kind_of_folder(path)
    if _is_scene(path.parent):
        return "part of a scene"
    suffix = path.suffix.lower()
    if suffix in SPLATS or path.name in SOG_JSONS:
        return "splat"
    if suffix in VIDEOS:
        return "video"
    return "picture" if suffix in PHOTOS else "file"


class Poses(NamedTuple):
    """Poses that a capture has in one form."""

    form: Form
    paths: list[Path]
    """The file, or the folders of COLMAP's models."""


def is_posed(folder: Path) -> bool:
    return bool(find_poses(folder))


def find_poses(folder: Path) -> list[Poses]:
    """The poses of a capture in each form and place that has some, those to use first."""
    if not is_folder(folder):
        return []
    found = [Poses(form, _poses_at(folder, form, places)) for form, places in POSES]
    return [poses for poses in found if poses.paths]


def find_foreign_poses(folder: Path) -> list[Path]:
    """Files that hold poses of the photos in a folder, but in forms or places that are not read."""
    beside = folder.name.startswith(PHOTO_FOLDERS)
    places = [*_folders(folder, FOREIGN_DEPTH), *([folder.parent] if beside else [])]
    return [path for place in places for path in _foreign_poses_in(place)]


def _poses_at(folder: Path, form: Form, places: Sequence[str]) -> list[Path]:
    paths = [path for place in places for path in _matching(folder, place)]
    if form != "colmap":
        return [path for path in paths if is_file(path)]
    whole = [path for path in paths if _model_files(path) == 2]
    if whole or "sparse" not in places[0]:
        return whole
    return [path for path in paths if _model_files(path) == 1]  # COLMAP's, but incomplete


def _matching(folder: Path, place: str) -> list[Path]:
    return sorted(folder.glob(place)) if "*" in place else [folder / place]


def _model_files(folder: Path) -> int:
    """How many of the two files that poses need are there."""
    return sum(
        any(is_file(folder / f"{kind}{suffix}") for suffix in (".bin", ".txt"))
        for kind in ("cameras", "images")
    )


def _folders(folder: Path, depth: int) -> Iterator[Path]:
    """A folder and those below it, without scenes, whose poses are our own."""
    if not _is_scene(folder):
        yield folder
        for inner in _entries(folder, Path.is_dir) if depth else ():
            yield from _folders(inner, depth - 1)


def _foreign_poses_in(folder: Path) -> list[Path]:
    files = _entries(
        folder, lambda p: any(fnmatch(p.name.lower(), pattern) for pattern in FOREIGN_POSES)
    )
    return files + [folder] * (_model_files(folder) == 2)


def find_capture(scene: Path, capture: str | None, relative: str | None) -> Path | None:
    """The capture of a scene: where it was, or beside the scene if both were moved together."""
    if capture is None:
        return None
    before = Path(capture)
    if relative is None or before.is_dir():
        return before
    moved = Path(os.path.normpath(scene.resolve() / relative))
    return moved if moved.is_dir() else before


Noun = Literal["scene", "capture", "splat"]
NOUNS: dict[Noun, tuple[str, str]] = {  # what it is called, and the remedy where it is not
    "scene": ("scene: it has no scene.json", "Give the folder that `train` or `import` made"),
    "capture": (
        "capture: it has neither sparse/0/cameras.bin (or .txt) nor transforms.json, nor photos",
        "Check the name, or give the folder of the photos",
    ),
    "splat": ("file of splats", f"Give one that ends in {', '.join(SPLATS)}, or convert it"),
}


def wrong_kind_error(path: Path, wanted: Noun) -> StyleSplatError:
    """The error for a path that should be a scene, capture or file of splats and is none."""
    kind = kind_of(path)
    if kind == "part of a scene" and wanted != "scene":
        path, kind = path.parent, "scene"
    (noun, remedy), inner = NOUNS[wanted], _entries(path, lambda entry: kind_of(entry) == wanted)
    noun, colon, why = noun.partition(":")
    fault = f"{path} is {_article(kind)}, not a {noun}"
    match wanted, kind:
        case _, "nothing":
            fault, remedy = f"There is no {noun} {path}", "Check the name"
        case "scene", "part of a scene":
            fault, remedy = f"{path} is a part of the scene {path.parent}", "Give the whole folder"
        case "splat", "scene":
            remedy = f"It has its splats: `{shell_command('objects', path)}` lists its objects"
        case "capture", "scene":
            remedy = _capture_of_scene(path)
        case "capture", "photos" | "video":
            way = shell_command("sfm", path, "-o", "CAPTURE")
            foreign = join_names(find_foreign_poses(path), whole=True)
            fault += ", as no camera poses are known"
            fault += f" (those in {foreign} are not read)" * bool(foreign)
            remedy = f"Find the cameras first: `{way}`; or give the capture that was made of it"
        case "capture", "part of a capture":
            fault = f"{path} holds the photos of the capture {path.parent}, whose poses are known"
            remedy = "Give that folder"
        case "capture", "picture":
            remedy = "Give the folder of all photos"
        case "capture", "folder" if sog := _sog_in(path):
            fault = f"{path} is a folder of splats, not photos"
            remedy = _way_to_scene(sog, "splat")
        case "capture", "empty folder":
            fault = f"{path} is an empty folder, but photos are needed: at least 3, better 30"
        case _, "splat" | "capture" | "part of a capture" | "photos" | "video":
            remedy = _way_to_scene(path, kind)
        case _ if inner:
            fault = f"{path} is not a {noun}, but holds some: {join_names(inner, whole=True)}"
            remedy = "Give one of them"
        case _:
            fault += colon + why
    return StyleSplatError(f"{fault}. {remedy}.")


def refuse_other_than_photos(path: Path) -> None:
    kind = kind_of(path)
    if kind in ("nothing", "empty folder", "scene", "part of a scene", "splat") or (
        kind == "folder" and _sog_in(path)
    ):
        raise wrong_kind_error(path, "capture")


def _capture_of_scene(scene: Path) -> str:
    content = read_json(scene / SCENE)
    capture = find_capture(scene, content.get("capture"), content.get("capture_relative"))
    if capture is not None:
        return f"It was made from {capture}, which has the photos: give that"
    ways = (
        shell_command("select", scene, "--name", "NAME", "--box3d", "x0,y0,z0,x1,y1,z1"),
        shell_command("mask", scene, "--box", "NAME=VIEW:x0,y0,x1,y1"),
    )
    return (
        f"Its photos are unknown: name objects by `{ways[0]}`, or in its own views by `{ways[1]}`"
    )


def _kind_of_folder(path: Path) -> FileKind:
    if _is_scene(path):
        return "scene"
    if is_posed(path):
        return "capture"
    if _is_scene(path.parent):
        return "part of a scene"
    photos = _photos_in(path) or any(_entries(path, _photos_in))
    if photos and path.name.startswith(PHOTO_FOLDERS) and is_posed(path.parent):
        return "part of a capture"
    if photos:
        return "photos"
    try:
        return "folder" if any(path.iterdir()) else "empty folder"
    except OSError:  # this user may not read it
        return "folder"


def _is_scene(path: Path) -> bool:
    return (path / SCENE).is_file()


def _sog_in(folder: Path) -> Path | None:
    """The file that says what splats a folder's pictures are, if there is one."""
    if is_file(folder / SOG_LEVELS):
        return folder / SOG_LEVELS
    is_sog = is_file(folder / SOG_META) and is_file(folder / SOG_MEANS)
    return folder / SOG_META if is_sog else None


def _photos_in(folder: Path) -> bool:
    """Whether a folder has photos itself; the pictures of a SOG are none."""
    other = ".webp" if is_file(folder / SOG_MEANS) else None
    suffixes = {*PHOTOS} - {other}
    return any(_entries(folder, lambda path: path.suffix.lower() in suffixes))


def _entries(path: Path, fits: Callable[[Path], bool]) -> list[Path]:
    """The entries of a folder that fit, sorted; none if the path is no readable folder."""
    try:
        return sorted(entry for entry in path.iterdir() if fits(entry)) if path.is_dir() else []
    except OSError:
        return []


def _article(kind: FileKind) -> str:
    if kind in ("photos", "part of a capture"):
        return "a folder of photos"
    return "an empty folder" if kind == "empty folder" else f"a {kind}"


def _way_to_scene(path: Path, kind: FileKind) -> str:
    source = path.parent if kind == "part of a capture" else path
    named = source.resolve().parent if source.name in SOG_JSONS else source.resolve()
    name = named.stem if named.is_file() else named.name
    verb = "import" if kind == "splat" else "train"
    return f"A scene is made of it by `{shell_command(verb, source, '-o', f'{name}-scene')}`"
