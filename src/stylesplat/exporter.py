"""Splats in the formats of other programs."""

from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.dot_splat import write_dot_splat
from stylesplat.io.splat_ply import write_splat_ply
from stylesplat.io.spz import write_spz
from stylesplat.scene.splats import Splats


def export(splats: Splats, path: Path | str, *, overwrite: bool = True) -> None:
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
