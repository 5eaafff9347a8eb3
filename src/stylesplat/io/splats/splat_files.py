"""Any file of splats, read and written."""

import os
from collections.abc import Callable
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import read_bytes
from stylesplat.io.kinds import no_splat
from stylesplat.io.splats.compressed_ply import MAX_HEADER, is_compressed, read_compressed_ply
from stylesplat.io.splats.dot_splat import read_dot_splat, write_dot_splat
from stylesplat.io.splats.splat_ply import read_splat_ply, write_splat_ply
from stylesplat.io.splats.spz import read_spz, write_spz
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
    if reader is None or path.is_dir() or not os.path.exists(path):  # noqa: PTH110
        raise no_splat(path)
    splats = reader(path)
    if not len(splats):
        raise StyleSplatError(f"There are no Gaussians in {path}. Choose another file.")
    return splats


def write_splats(splats: Splats, path: Path | str, *, overwrite: bool = True) -> None:
    """Write splats for a viewer, in the format that the file's suffix names.

    `.ply` keeps every bit. `.spz` is about ten times smaller: positions, colours and rotations
    are rounded. `.splat` has one colour per Gaussian, seen the same from everywhere.

    Args:
        splats: What to write.
        path: A file name ending in `.ply`, `.spz` or `.splat`.
        overwrite: Whether a file of that name may be replaced.

    Raises:
        StyleSplatError: If the suffix is none of these, the file exists and may not be replaced,
            it cannot be written, or the splats reach farther than `.spz` can express.
    """
    path = Path(path)
    writers = {".ply": write_splat_ply, ".spz": write_spz, ".splat": write_dot_splat}
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise StyleSplatError(
            f"Cannot export to {path}: unknown suffix {path.suffix!r}. Use {', '.join(writers)}."
        )
    if path.exists() and not overwrite:
        raise StyleSplatError(f"{path} exists already. Replace it with `--overwrite`.")
    writer(splats.detach().to("cpu"), path)


def _read_ply(path: Path) -> Splats:
    if is_compressed(read_bytes(path, first=MAX_HEADER)):
        return read_compressed_ply(path, read_bytes(path))
    return read_splat_ply(path)
