"""Rendered views on disk: a folder under the photos' names, a video, or one picture."""

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import chain, islice
from pathlib import Path, PurePosixPath

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_folder, changing, refuse_file, refuse_occupied
from stylesplat.io.files import inside
from stylesplat.io.gif import write_gif
from stylesplat.io.images import ViewPicture, write_image, write_numbers
from stylesplat.io.json_files import write_json
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.video import KINDS, write_video

GIF, TIFF, PNG, WEBP = ".gif", (".tif", ".tiff"), ".png", ".webp"
VIDEOS = (*KINDS, GIF)
COLORS = (PNG, ".jpg", ".jpeg", WEBP)  # one picture; several make WebP an animation
WITH_ALPHA = (PNG, WEBP)
# Names of files that nobody means as a folder
FOREIGN = (
    *(".avi", ".m4v", ".wmv", ".flv", ".mpg", ".mpeg", ".ogv", ".apng", ".avif", ".bmp", ".exr"),
    *(".hdr", ".heic", ".jxl", ".pdf", ".ppm", ".psd", ".svg", ".tga", ".zip", ".ts", ".3gp"),
    *(".obj", ".ply", ".glb", ".gltf", ".spz", ".sog", ".splat", ".ksplat", ".npy", ".npz"),
    *(
        ".html",
        ".usd",
        ".usdz",
        ".json",
        ".yaml",
        ".yml",
        ".txt",
        ".csv",
        ".md",
        ".tar",
        ".gz",
        ".7z",
        ".rar",
    ),
)
SCALE = "depth.json"  # beside depths of 16 bits: what a step is


def png_names(names: Sequence[str], suffix: str = PNG) -> list[str]:
    """The photos' names as PNGs inside a folder; those that would be the same keep their suffixes.

    Example:
        >>> png_names(["cam0/1.jpg", "cam1/1.jpg", "a.jpg", "a.png", "../b.jpg"])
        ['cam0/1.png', 'cam1/1.png', 'a.jpg.png', 'a.png.png', '_/b.png']
    """
    inside = [_inside(name) for name in names]
    plain = [path.with_suffix(suffix).as_posix() for path in inside]
    whole = [f"{path.as_posix()}{suffix}" for path in inside]
    pairs = list(zip(plain, whole, strict=True))
    wanted = Counter(name for pair in pairs for name in {*pair})
    return [short if wanted[short] == 1 else long for short, long in pairs]


def refuse_taken(output: Path, *, overwrite: bool) -> None:
    """Check that views may be written, before the work that renders them.

    Raises:
        StyleSplatError: If the name is of a file that we cannot make, or there is something in the
            place, and it may not be replaced.
    """
    suffix = output.suffix.lower()
    if suffix in FOREIGN and not output.is_dir():
        raise StyleSplatError(
            f"Cannot render into {output}: {suffix} is not among the formats. Use "
            f"{', '.join(VIDEOS)} for a video, {', '.join((*COLORS, *TIFF))} for one picture, or "
            "the name of a folder."
        )
    if not _is_file(output):
        refuse_occupied(output, marker="", overwrite=overwrite)
    else:
        refuse_file(output, overwrite=overwrite)


def write_views(
    names: Sequence[str],
    pictures: Iterable[ViewPicture],
    output: Path,
    *,
    overwrite: bool = False,
    scale: float | None = None,
    fps: float | int | None = None,
) -> None:
    """Write each view under the photo's name, sub-folders kept; or all as a video; or one.

    In a folder colours and ids are PNGs and depths in world units TIFFs.

    Args:
        names: Of the photos.
        pictures: Images, label ids or depths; taken one by one.
        output: A folder; a video, which takes images only; or a picture, if there is one view.
        overwrite: Whether what is there may be replaced.
        scale: World units that depths of 16 bits count in; written beside them.
        fps: Frames a second of a video; by default 30, and 14 of a GIF.

    Raises:
        StyleSplatError: If the place is taken or cannot be written to, or views of this kind, or
            as many, cannot be written in that form.
    """
    moving = is_video(output, len(names))
    if fps is not None and not moving:
        raise StyleSplatError(f"{output} has no frames a second. Leave --fps out, or name a video.")
    if not moving and output.suffix.lower() in (*COLORS, *TIFF) and len(names) != 1:
        raise StyleSplatError(
            f"{output} is one picture, and there are {len(names)} views. Choose one with "
            "--view NAME, or name a folder."
        )
    rest = iter(pictures)
    some = [*islice(rest, 1)]
    if some:
        _refuse_unfit(some[0], output)
    pictures = chain(some, rest)
    if _is_file(output):
        with changing(output):
            if moving:
                _write_video(pictures, output, {} if fps is None else {"fps": fps})
            else:
                for picture in pictures:
                    _write_picture(picture, output)
        return
    with atomic_folder(output, overwrite=overwrite, marker="") as folder:
        suffix = TIFF[0] if some and some[0].is_floating_point() else PNG
        for name, picture in zip(png_names(names, suffix), pictures, strict=True):
            _write_picture(picture, inside(folder, name))
        if scale is not None:
            write_json({"world_units_per_step": scale, "nothing": 0}, folder / SCALE)


def is_video(output: Path, count: int) -> bool:
    """Whether so many views are written as a video, or an animation, there."""
    suffix = output.suffix.lower()
    return suffix in VIDEOS and (suffix != WEBP or count != 1)


def is_gif(output: Path) -> bool:
    """Whether that video is a GIF."""
    return output.suffix.lower() == GIF


def _is_file(output: Path) -> bool:
    """Whether views are written into one file there."""
    return output.suffix.lower() in (*VIDEOS, *COLORS, *TIFF)


def _refuse_unfit(picture: ViewPicture, output: Path) -> None:
    """Refuse files that cannot hold such pictures."""
    suffix = output.suffix.lower()
    colors, transparent = picture.ndim == 3, picture.ndim == 3 and picture.shape[-1] == 4
    if transparent and _is_file(output) and suffix not in WITH_ALPHA:
        raise StyleSplatError(
            f"{suffix} has no transparency here. Choose a --background, such as white, or write "
            "a folder, a .png or a .webp."
        )
    if picture.dtype == torch.uint16 and _is_file(output):
        raise StyleSplatError(
            f"Depths of 16 bits go into a folder, beside what a step is ({SCALE}). Name a folder, "
            "or write depth-float into a .tif."
        )
    wanted = TIFF if picture.is_floating_point() else (PNG,)
    if not colors and _is_file(output) and suffix not in wanted:
        what = "Depths in world units" if wanted == TIFF else "Label ids"
        raise StyleSplatError(
            f"{what} go into {wanted[0]} files, not into {suffix}. Name a folder or a {wanted[0]}, "
            "or choose depth or label-colors, which are colours."
        )
    if colors and suffix in TIFF:
        raise StyleSplatError(f"{suffix} is for depth-float. Write colours into a .png.")


def _write_video(
    pictures: Iterable[ViewPicture], output: Path, rate: dict[str, float | int]
) -> None:
    if is_gif(output):
        write_gif(pictures, output, **rate)
    else:
        write_video(pictures, output, **rate)


def _write_picture(picture: ViewPicture, path: Path) -> None:
    if picture.ndim == 3:
        write_image(picture, path)
    elif picture.is_floating_point() or picture.dtype == torch.uint16:
        write_numbers(picture, path)
    else:
        write_label_map(picture, path)


def _inside(name: str) -> PurePosixPath:
    """A photo's name as a path that does not leave its folder."""
    path = PurePosixPath(name)
    parts = path.parts[1:] if path.is_absolute() else path.parts
    return PurePosixPath(*("_" if part == ".." else part for part in parts or ("_",)))
