"""A textured mesh of an object: its surface, unwrapped, with the colours of its renders."""

from importlib.util import find_spec

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.style_pictures import picture_file
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.meshes.refine import refine
from stylesplat.meshes.surface import find_mesh_surface, mesh_views, simplify
from stylesplat.meshes.texture import TexturedMesh, bake, baked_length, unwrap
from stylesplat.progress import say
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import Layer
from stylesplat.scene.splats import Splats

MODULES = ("skimage", "fast_simplification", "xatlas")


@torch.no_grad()
def make_mesh(
    splats: Splats,
    photos: Cameras | None,
    config: MeshConfig,
    *,
    name: str = "The object",
    paint: tuple[Layer, Splats] | None = None,
) -> TexturedMesh:
    """Make a mesh of splats that are one object, seen from `photos` if these are known.

    `paint` holds, of a painted object, its layer and the object alone without paint, to repaint it.
    Raises a StyleSplatError if the object has no surface, as smoke has none.
    """
    if not all(map(find_spec, MODULES)):
        raise StyleSplatError(
            "A mesh needs scikit-image, fast-simplification and xatlas. Run `pip install "
            "'stylesplat[mesh]'`."
        )
    if config.repaint:
        _refuse_repainting(paint, name)
    splats = splats.detach().to("cpu")
    surface, open_share = find_mesh_surface(splats, photos, config.faces, name)
    if open_share > 0:
        say(
            f"{name} was photographed from one side only: the mesh is open where {open_share:.0%} "
            "of its surface would be."
        )
    views = mesh_views(splats, photos, length=baked_length(config.texture_size))
    surface = refine(simplify(surface, config.faces), splats, views)
    mesh = bake(unwrap(surface, config.texture_size), splats, views)
    if not config.repaint:
        return mesh
    from stylesplat.meshes.repaint import repaint

    assert paint is not None
    layer, unpainted = paint
    return repaint(mesh, unpainted, views, layer, name)


def _refuse_repainting(paint: tuple[Layer, Splats] | None, name: str) -> None:
    if paint is None:
        raise StyleSplatError(
            f"{name} is not painted, so that there is nothing to repaint. Style it first, or leave "
            "--repaint out."
        )
    if paint[0].mask is not None or paint[0].blend != "normal":
        raise StyleSplatError(
            f"Cannot repaint {name}: its paint has a mask or a blend, which are lost in a texture. "
            "Leave --repaint out."
        )
    files = [source.path for source in paint[0].styles]
    there = (file and picture_file(file).is_file() for file in files)
    if not files or not all(there):
        raise StyleSplatError(
            f"Cannot repaint {name}: a picture of its style is gone. Put it back, or leave "
            "--repaint out."
        )
