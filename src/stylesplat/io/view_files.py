"""Rendered views on disk: a folder under the photos' names, a video, or one picture."""

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import chain
from pathlib import Path, PurePosixPath

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_folder, changing, refuse_file, refuse_occupied
from stylesplat.io.files import inside
from stylesplat.io.images import ViewPicture, write_image, write_numbers
from stylesplat.io.kinds import PHOTOS, SPLATS, VIDEOS
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.video import CODECS, write_video

TIFF, PNG, WEBP = (".tif", ".tiff"), ".png", ".webp"
COLORS = (PNG, ".jpg", ".jpeg", WEBP)  # one picture; several make WebP an animation
WITH_ALPHA = (PNG, WEBP)
# Suffixes of files, which nobody wants as the name of a folder
FOREIGN = (
    *(".apng", ".exr", ".flv", ".hdr", ".jxl", ".ksplat", ".npy", ".npz", ".obj", ".ogv", ".ts"),
    *(".7z", ".csv", ".gz", ".html", ".json", ".md", ".mpeg", ".pdf", ".psd", ".rar", ".svg"),
    *(".tar", ".txt", ".usd", ".usdz", ".yaml", ".yml", ".zip", *SPLATS, *PHOTOS, *VIDEOS),
)


def png_names(names: Sequence[str], suffix: str = PNG) -> list[str]:
    """The photos' names with another suffix; where two would be equal, the old suffix stays.

    Example:
        >>> png_names(["cam0/1.jpg", "cam1/1.jpg", "a.jpg", "a.png", "../b.jpg"])
        ['cam0/1.png', 'cam1/1.png', 'a.jpg.png', 'a.png.png', '_/b.png']
    """
    pairs = []
    for name in names:
        path = PurePosixPath(name)
        parts = path.parts[1:] if path.is_absolute() else path.parts
        path = PurePosixPath(*("_" if part == ".." else part for part in parts or ("_",)))
        pairs.append((path.with_suffix(suffix).as_posix(), f"{path.as_posix()}{suffix}"))
    wanted = Counter(name for pair in pairs for name in {*pair})
    return [short if wanted[short] == 1 else long for short, long in pairs]


def refuse_taken(output: Path, *, overwrite: bool) -> None:
    """Raise a StyleSplatError unless `write_views` can write here; ask before the work."""
    suffix = output.suffix.lower()
    if suffix in FOREIGN and not _is_file(output) and not output.is_dir():
        raise StyleSplatError(
            f"Cannot render into {output}: {suffix} is not among the formats. Use "
            f"{', '.join(CODECS)} for a video, {', '.join((*COLORS, *TIFF))} for one picture, or "
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
    fps: float | int | None = None,
) -> None:
    """Write each view under the photo's name, sub-folders kept; or all as a video; or one picture.

    In a folder colours and ids become PNGs and depths in world units TIFFs. `pictures` are images,
    label ids or depths and are taken one by one. `fps` is by default 30.
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
    first = next(rest, None)
    if first is not None:
        _refuse_unfit(first, output)
        rest = chain([first], rest)
    if _is_file(output):
        with changing(output):
            if moving:
                write_video(rest, output, fps=fps or 30)
            else:
                for picture in rest:
                    _write_picture(picture, output)
        return
    with atomic_folder(output, overwrite=overwrite, marker="") as folder:
        suffix = TIFF[0] if first is not None and first.is_floating_point() else PNG
        for name, picture in zip(png_names(names, suffix), rest, strict=True):
            _write_picture(picture, inside(folder, name))


def is_video(output: Path, count: int) -> bool:
    """Whether `count` views are written as a video or an animation."""
    suffix = output.suffix.lower()
    return suffix in CODECS and (suffix != WEBP or count != 1)


def _is_file(output: Path) -> bool:
    return output.suffix.lower() in (*CODECS, *COLORS, *TIFF)


def _refuse_unfit(picture: ViewPicture, output: Path) -> None:
    suffix = output.suffix.lower()
    colors, transparent = picture.ndim == 3, picture.ndim == 3 and picture.shape[-1] == 4
    if transparent and _is_file(output) and suffix not in WITH_ALPHA:
        raise StyleSplatError(
            f"{suffix} has no transparency here. Choose a --background, such as white, or write "
            "a folder, a .png or a .webp."
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


def _write_picture(picture: ViewPicture, path: Path) -> None:
    if picture.ndim == 3:
        write_image(picture, path)
    elif picture.is_floating_point():
        write_numbers(picture, path)
    else:
        write_label_map(picture, path)
