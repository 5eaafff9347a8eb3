"""`export`: splats in the formats of other programs, or as a page that shows them."""

from collections.abc import Sequence
from pathlib import Path

from stylesplat.drawing.web_page import SUFFIX, write_page
from stylesplat.errors import StyleSplatError
from stylesplat.io.folders import claim_directory
from stylesplat.io.recovery import changing
from stylesplat.io.splats.splat_files import write_splats
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.scene_parts import every_part, part_of


def export(
    what: Scene | Splats,
    path: Path | str,
    *,
    objects: Sequence[str] = (),
    without: Sequence[str] = (),
    overwrite: bool = False,
    sh_degree: int | None = None,
) -> int:
    """Write a scene's splats for a viewer, in the format that the file's suffix names.

    Args:
        what: A scene, or splats alone.
        path: A file name ending in `.ply`, which keeps every bit; in `.compressed.ply`, as
            SuperSplat compresses, four times smaller; in `.spz`, about six times smaller; in
            `.sog`, seven times or more; in `.splat`, one colour per Gaussian; in `.glb`, glTF
            with Khronos' KHR_gaussian_splatting, all as float32; or in `.html`, a page that any
            browser opens from the disk, without a network, and that compares a styled scene with
            what it was before.
        objects: Names or label ids of what to write alone; by default everything. It lies where
            it does in the scene, so that parts fit together again.
        without: Names or label ids of what to leave out.
        overwrite: Whether a file of that name may be replaced.
        sh_degree: Up to which degree, 0 to 3, colours may depend on where they are seen from; what
            is above is left out. By default nothing is: `.ply` has the columns of degree 3, as
            INRIA's, the others have as many as are not all zero.

    Returns:
        How many Gaussians were written.

    Raises:
        StyleSplatError: If the suffix is none of these or has no such degree, the file exists and
            may not be replaced, it cannot be written, the splats reach farther than `.spz` can
            express or are none that a `.glb` can hold, the scene has no such object, nothing is
            left, or nothing would show on a page.
    """
    path = Path(path)
    if objects or without:
        what = part_of(_scene(what), objects, without)
    splats = what if isinstance(what, Splats) else what.splats
    with changing(path):
        if path.suffix.lower() == SUFFIX:
            write_page(what, path, overwrite=overwrite, sh_degree=sh_degree)
        else:
            write_splats(splats, path, overwrite=overwrite, sh_degree=sh_degree)
    return len(splats)


def export_each(
    scene: Scene,
    folder: Path | str,
    *,
    suffix: str = ".ply",
    overwrite: bool = False,
    sh_degree: int | None = None,
) -> list[Path]:
    """Write each object of a scene into a file of its name, and the rest into one more.

    Args:
        scene: With objects.
        folder: Where the files go, all or none of them.
        suffix: Of their format; see `export`.
        overwrite: Whether files of these names may be replaced.
        sh_degree: See `export`.

    Returns:
        The files, `rest` being what belongs to no object.

    Raises:
        StyleSplatError: As `export` does, or if the scene has no objects.
    """
    parts = every_part(_scene(scene))
    names = [f"{name}{suffix}" for name in parts]
    with claim_directory(folder, overwrite=overwrite, marker="") as new:
        for name, part in zip(names, parts.values(), strict=True):
            export(part, new / name, sh_degree=sh_degree)
    return [Path(folder) / name for name in names]


def _scene(what: Scene | Splats) -> Scene:
    if isinstance(what, Splats):
        raise StyleSplatError("Splats alone have no objects. Export a scene.")
    return what
