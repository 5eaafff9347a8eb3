"""Any file of splats."""

from collections.abc import Callable
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.compressed_ply import MAX_HEADER, is_compressed, read_compressed_ply
from stylesplat.io.dot_splat import read_dot_splat
from stylesplat.io.splat_ply import read_splat_ply
from stylesplat.io.spz import read_spz
from stylesplat.scene.splats import Splats


def read_splats(path: Path | str) -> Splats:
    """Read splats as other programs write them, in the world frame of their file.

    PLY as INRIA, gsplat, nerfstudio and Postshot write it, SuperSplat's compressed PLY, SPZ and
    .splat. No memory is taken for a count in a header before it was checked against the file.

    Raises:
        StyleSplatError: If the file is missing, of another kind, damaged or empty.
    """
    path = Path(path)
    readers: dict[str, Callable[[Path], Splats]] = {
        ".ply": _read_ply,
        ".spz": read_spz,
        ".splat": read_dot_splat,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise StyleSplatError(
            f"Cannot read {path} as splats: unknown suffix {path.suffix!r}. "
            f"Convert it to one of {', '.join(readers)}."
        )
    splats = reader(path)
    if not len(splats):
        raise StyleSplatError(f"There are no Gaussians in {path}. Choose another file.")
    return splats


def _read_ply(path: Path) -> Splats:
    try:
        with path.open("rb") as file:
            head = file.read(MAX_HEADER)
    except OSError as error:
        raise StyleSplatError(f"Cannot read {path}: {error.strerror}.") from error
    if is_compressed(head):
        return read_compressed_ply(path, path.read_bytes())
    return read_splat_ply(path)
