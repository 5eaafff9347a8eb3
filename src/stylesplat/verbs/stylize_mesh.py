"""`stylize` of somebody's mesh: its base colour repainted, and nothing else of the file changed."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError, check_choice, join_names
from stylesplat.io.atomic import locked_folder
from stylesplat.io.models.model import Part
from stylesplat.io.models.model_files import (
    read_model,
    refuse_model_file,
    write_model,
)
from stylesplat.io.style_pictures import Picture
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.meshes.paint_model import in_unit_ball, lay_out, paint_texture, sample_discs
from stylesplat.meshes.surface import cameras_all_around
from stylesplat.options import check_arguments
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.stylization.config import Network
from stylesplat.stylization.style import Style, as_style
from stylesplat.verbs.stylize import stylize

WHOLE_MESH = "all"  # the name of a mesh that is painted as one
MESH_VIEW_LENGTH = 960  # pixels of the views in which it is painted


@check_arguments
def stylize_mesh(
    mesh: Path | str,
    styles: Style | Picture | Sequence[Picture] | Mapping[str, Style | Picture | Sequence[Picture]],
    output: Path | str,
    *,
    features: Network | None = None,
    weights: Path | str | None = None,
    texture_size: int = MeshConfig.texture_size,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Repaint a mesh in the style of pictures, in its base-colour texture.

    Its surface is sampled as discs, which are painted as a splat is, and the paint goes into the
    texture, whose strokes are then as fine as its texels. UVs stay where each place of the texture
    is one place of the surface; else the paint gets UVs of its own. All else of the file stays:
    shapes, normals, bones, animations, other textures and materials.

    Args:
        mesh: A `.glb`, `.obj` or `.ply` file.
        styles: Pictures or a `Style` for all of it; or by the names of nodes or materials (of an
            `.obj`: materials), of which each is painted for itself and what has none stays.
        output: The `.glb` file to make; of an `.obj` or `.ply` also an `.obj`, with its `.mtl` and
            pictures beside it.
        features: The network whose features are matched.
        weights: The network's file.
        texture_size: Pixels of a side of the texture, a power of two; of several textures their
            sides are about this long.
        device: Where to compute.
        overwrite: Whether a file of that name may be replaced.

    Returns:
        `seconds`; `faces` that were painted; `pictures`, the sides of the new textures in pixels;
        `unwrapped`, of how many faces new UVs were made.

    Raises:
        StyleSplatError: If a file is unfit, the mesh has no faces, or a name means nothing in it.

    Example:
        >>> stylize_mesh("truck.glb", {"wheels": "wave.jpg"}, "painted.glb")  # doctest: +SKIP
    """
    start, mesh, output = time.perf_counter(), Path(mesh), Path(output)
    MeshConfig(texture_size=texture_size)  # which checks it
    refuse_model_file(mesh, output, overwrite=overwrite)
    model = read_model(mesh)
    if isinstance(styles, Mapping):
        named, chosen = styles, _chosen(model.parts, styles)
    else:
        named, chosen = {WHOLE_MESH: styles}, {WHOLE_MESH: [*model.parts]}
    painted, pictures = [], []
    for name, parts in chosen.items():
        style, places = as_style(named[name]), in_unit_ball(parts)
        layout = lay_out(parts, places, texture_size)
        discs = sample_discs(parts, places, texture_size=texture_size, seed=style.config.seed)
        everything = SceneObject(torch.ones(len(discs), dtype=torch.bool))
        cameras = cameras_all_around(discs, length=MESH_VIEW_LENGTH)
        scene = Scene(discs, cameras).with_object(name, everything)
        options = {"features": features, "weights": weights, "device": device, "measured": False}
        styled = stylize(scene, {name: style}, **options)
        texture = paint_texture(layout, discs, styled.splats, styled.layers[0], style, name)
        painted += layout.after(len(pictures))
        pictures += layout.pictures(texture)
    with locked_folder(output):
        write_model(model, painted, pictures, output, overwrite=overwrite)
    return {
        "seconds": time.perf_counter() - start,
        "faces": sum(len(each.part.faces) for each in painted),
        "pictures": [len(each) for each in pictures],
        "unwrapped": sum(len(each.part.faces) for each in painted if each.unwrapped is not None),
    }


def _chosen(parts: Sequence[Part], names: Mapping[str, object]) -> dict[str, list[Part]]:
    """The parts of each name; a StyleSplatError if one means nothing, or two mean the same."""
    found, by_part = dict[str, list[Part]](), dict[int, str]()
    known = [*dict.fromkeys(name for part in parts for name in part.names)]
    for name in names:
        check_choice(name, "node or material of the mesh", known)
        found[name] = [part for part in parts if name in part.names]
        for part in found[name]:
            other = by_part.setdefault(id(part), name)
            if other != name:
                raise StyleSplatError(
                    f"{name} and {other} mean the same faces ({join_names(part.names)}). Give them "
                    "one style."
                )
    return found
