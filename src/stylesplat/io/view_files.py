"""Rendered views on disk: a folder of PNGs under the photos' names, or a video."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath

from jaxtyping import Int, UInt8
from torch import Tensor

from stylesplat.io.files import inside
from stylesplat.io.folders import claim_directory, refuse_occupied
from stylesplat.io.images import write_image
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.places import refuse_file
from stylesplat.io.recovery import changing
from stylesplat.io.video import write_video

VIDEO = ".mp4"


def png_names(names: Sequence[str]) -> list[str]:
    """The photos' names as PNGs inside a folder; those that would be the same keep their suffixes.

    Example:
        >>> png_names(["cam0/1.jpg", "cam1/1.jpg", "a.jpg", "a.png", "../b.jpg"])
        ['cam0/1.png', 'cam1/1.png', 'a.jpg.png', 'a.png.png', '_/b.png']
    """
    inside = [_inside(name) for name in names]
    plain = [path.with_suffix(".png").as_posix() for path in inside]
    whole = [f"{path.as_posix()}.png" for path in inside]
    pairs = list(zip(plain, whole, strict=True))
    wanted = Counter(name for pair in pairs for name in {*pair})
    return [short if wanted[short] == 1 else long for short, long in pairs]


def refuse_taken(output: Path, *, overwrite: bool) -> None:
    """Check that views may be written, before the work that renders them.

    Raises:
        StyleSplatError: If there is something in the place, and it may not be replaced.
    """
    if not is_video(output):
        refuse_occupied(output, marker="", overwrite=overwrite)
    else:
        refuse_file(output, overwrite=overwrite)


def write_views(
    names: Sequence[str],
    pictures: Iterable[UInt8[Tensor, "H W 3"] | Int[Tensor, "H W"]],
    output: Path,
    *,
    overwrite: bool = False,
) -> None:
    """Write a PNG per view under the photo's name, sub-folders kept; or all as a video.

    Args:
        names: Of the photos.
        pictures: Images, or label ids; taken one by one.
        output: A folder, or a file that ends in .mp4, which takes images only.
        overwrite: Whether what is there may be replaced.

    Raises:
        StyleSplatError: If the place is taken or cannot be written to.
    """
    if is_video(output):
        with changing(output):
            write_video(pictures, output)
        return
    with claim_directory(output, overwrite=overwrite, marker="") as folder:
        for name, picture in zip(png_names(names), pictures, strict=True):
            write = write_label_map if picture.ndim == 2 else write_image
            write(picture, inside(folder, name))


def is_video(output: Path) -> bool:
    """Whether views are written as a video there."""
    return output.suffix.lower() == VIDEO


def _inside(name: str) -> PurePosixPath:
    """A photo's name as a path that does not leave its folder."""
    path = PurePosixPath(name)
    parts = path.parts[1:] if path.is_absolute() else path.parts
    return PurePosixPath(*("_" if part == ".." else part for part in parts or ("_",)))
