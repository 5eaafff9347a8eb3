"""`export`: splats in the formats of other programs, or as a web page."""

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.web_page import WEB_SUFFIX, write_page
from stylesplat.io.atomic import atomic_folder, locked_folder, refuse_file
from stylesplat.io.gaussian_lists import LISTS, SIDECAR, STATE, write_objects
from stylesplat.io.splats.splat_files import row_order, write_splats
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.options import check_arguments
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.scene.virtual_cameras import has_rendered_views
from stylesplat.selection.objects import cut_out, every_part, listed_objects, part_mask
from stylesplat.selection.resolve import find_object

EXPORT_KINDS = {WEB_SUFFIX: "a page", LISTS: "a list of objects"}
IDLE = {  # options without an effect
    "a page": ("selected", "sidecar", "spz_version"),
    "a list of objects": ("without", "selected", "sidecar", "sh_degree", "spz_version"),
    "a mesh": ("selected", "sidecar", "sh_degree", "spz_version"),
}


@check_arguments
def export(
    what: Scene | Splats,
    path: Path | str,
    *,
    objects: Sequence[str] = (),
    without: Sequence[str] = (),
    selected: Sequence[str] = (),
    sidecar: bool = False,
    overwrite: bool = False,
    sh_degree: int | None = None,
    mesh: MeshConfig | None = None,
    spz_version: int | None = None,
) -> int:
    """Write a scene's splats for a viewer, in the format that the file's suffix names.

    Args:
        what: A scene, or splats alone.
        path: A file name ending in `.ply`, which keeps every bit; in `.compressed.ply`,
            SuperSplat's form, four times smaller; in `.spz`, about six times smaller; in
            `.sog`, seven times or more; in `.splat`, one colour per Gaussian; in `.glb` or
            `.gltf`, glTF with Khronos' KHR_gaussian_splatting, as float32; in `.usd`, `.usda`,
            `.usdc` or `.usdz`, which needs `stylesplat[usd]`; or in `.html`, a page
            that any browser opens without a network, and that compares a styled scene with what
            it was before. A `.npz` gets the rows and shares of the objects instead.
        objects: Names or label ids of the objects to write; by default everything. Positions are
            those in the scene, so that parts fit together again.
        without: Names or label ids of objects to leave out.
        selected: Names or label ids of objects that a `.ply` marks as selected in SuperSplat.
        sidecar: Whether a second file, `path` with `.objects.npz` added, lists the objects in the
            order of the file's rows.
        overwrite: Whether a file of that name may be replaced.
        sh_degree: Highest degree of spherical harmonics, 0 to 3, that is written. By default no
            band is lost: `.ply` has the columns of degree 3, as INRIA's, the others as many as are
            not all zero.
        mesh: Settings of a textured mesh, which is written instead of splats, into a `.glb` or
            `.obj`: of one object, or of a scene that shows one. Needs `stylesplat[mesh]`.
        spz_version: Version of a `.spz`: 4 by default; 3 or 2 for programs that read no newer one.
            With 2 a `.glb` or `.gltf` holds SPZ, for CesiumJS.

    Returns:
        How many Gaussians were written; of a mesh, how many faces; into a `.npz`, how many objects.

    Raises:
        StyleSplatError: If the format is unknown or cannot hold the splats, the file exists and
            `overwrite` is off, it cannot be written, the scene has no such object, or nothing is
            left to write.
    """
    path = Path(path)
    kind = "a mesh" if mesh else EXPORT_KINDS.get(path.suffix.lower())
    given = {"without": without, "selected": selected, "sidecar": sidecar}
    given |= {"sh_degree": sh_degree is not None, "spz_version": spz_version is not None}
    for name in IDLE.get(kind or "", ()):
        if given[name]:
            option = name.replace("_", "-")
            raise StyleSplatError(f"--{option} means nothing for {kind}, {path}. Leave it out.")
    if kind == "a list of objects":
        refuse_file(path, overwrite=overwrite)
        listed = listed_objects(_scene(what), objects)
        with locked_folder(path):
            write_objects(listed, path)
        return len(listed.objects)
    if mesh is not None:
        return _export_mesh(what, path, objects, without, mesh, overwrite=overwrite)
    beside = path.with_name(path.name + SIDECAR)
    if sidecar:
        refuse_file(beside, overwrite=overwrite)
    listed = listed_objects(_scene(what)) if sidecar else None
    besides = dict[str, Tensor]()
    if selected:
        masks = [find_object(_scene(what), name).cpu() for name in selected]
        besides[STATE] = _scene(what).to_splats(torch.stack(masks).any(dim=0)).byte()
    part = what
    if objects or without:
        mask = part_mask(_scene(what), objects, without)
        rows = _scene(what).to_splats(mask).nonzero()[:, 0]
        part, listed = cut_out(_scene(what), mask), listed and listed.ordered(rows)
        besides = {name: column[rows] for name, column in besides.items()}
    splats = part if isinstance(part, Splats) else part.splats
    with locked_folder(path):
        if kind == "a page":
            write_page(part, path, overwrite=overwrite, sh_degree=sh_degree)
        else:
            options = {"sh_degree": sh_degree, "spz_version": spz_version, "besides": besides}
            write_splats(splats, path, overwrite=overwrite, **options)
        if listed is not None:
            write_objects(listed.ordered(row_order(splats, path)), beside)
    return len(splats)


def _export_mesh(
    what: Scene | Splats,
    path: Path,
    objects: Sequence[str],
    without: Sequence[str],
    config: MeshConfig,
    *,
    overwrite: bool,
) -> int:
    from stylesplat.meshes.mesh import make_mesh
    from stylesplat.meshes.mesh_files import refuse_mesh_file, write_mesh

    refuse_mesh_file(path, overwrite=overwrite)
    name, photos, paint = " and ".join(objects) or "The scene", None, None
    if isinstance(what, Splats) and not (objects or without):
        splats = what
    else:
        what = _scene(what)
        photos = None if has_rendered_views(what) else what.working_views()[0]
        mask = part_mask(what, objects, without)
        splats = what.splats[what.to_splats(mask)]
        painted = [each for each in what.layers if [each.object] == [*objects]]
        if painted and painted[0].is_shown:
            paint = painted[0], what.base[mask]
    mesh = make_mesh(splats, photos, config, name=name, paint=paint)
    with locked_folder(path):
        write_mesh(mesh, path, splats.world_offset)
    return len(mesh.faces)


def export_each(
    scene: Scene,
    folder: Path | str,
    *,
    suffix: str = ".ply",
    overwrite: bool = False,
    sh_degree: int | None = None,
) -> list[Path]:
    """Write each object into its own file of a folder, all or none, and the rest into `rest`.

    Returns the files. For `suffix` and `sh_degree` see `export`.
    """
    parts = every_part(_scene(scene))
    names = [f"{name}{suffix}" for name in parts]
    with atomic_folder(folder, overwrite=overwrite, marker="") as new:
        for name, part in zip(names, parts.values(), strict=True):
            export(part, new / name, sh_degree=sh_degree)
    return [Path(folder) / name for name in names]


def _scene(what: Scene | Splats) -> Scene:
    if isinstance(what, Splats):
        raise StyleSplatError("Splats alone have no objects. Export a scene.")
    return what
