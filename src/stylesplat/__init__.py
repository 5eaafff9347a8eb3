"""StyleSplat: repaint chosen objects of a 3D Gaussian splat in the style of any picture.

Eight verbs over three nouns (`Capture`, `Cameras`, `Splats`)::

    import stylesplat as ss
    capture = ss.load("garden/")                 # posed photos
    capture = ss.mask(capture)                   # + one label map per photo
    splats = ss.train(capture)                   # Gaussians + identities
    picked = ss.select(splats, object_id=3)      # [N] bool
    styled = ss.stylize(splats, capture, picked, style="wave.jpg")
    ss.export(styled, "garden.ply"); ss.view(styled)
    render_colors, render_alphas, info = ss.render(styled, capture.cameras[:1])
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from stylesplat.runtime import tune_runtime

if TYPE_CHECKING:
    from stylesplat.drawing.browser import view
    from stylesplat.errors import StyleSplatError
    from stylesplat.io.captures.capture_folder import load
    from stylesplat.masks.attach import mask
    from stylesplat.rendering.rasterize import rasterize as render
    from stylesplat.scene.cameras import Cameras
    from stylesplat.scene.capture import Capture
    from stylesplat.scene.splats import Splats
    from stylesplat.selection.pick import select
    from stylesplat.stylization.paint_objects import stylize
    from stylesplat.verbs.export import export
    from stylesplat.verbs.train import train

__all__ = [
    "Cameras",
    "Capture",
    "Splats",
    "StyleSplatError",
    "export",
    "load",
    "mask",
    "render",
    "select",
    "stylize",
    "train",
    "view",
]

tune_runtime()

# Imported on first use, so that `stylesplat --help` need not wait for torch.
_HOMES = {
    "Cameras": "scene.cameras",
    "Capture": "scene.capture",
    "Splats": "scene.splats",
    "StyleSplatError": "errors",
    "export": "verbs.export",
    "load": "io.load",
    "mask": "masks.attach",
    "render": "rendering.rasterize",
    "select": "selection.pick",
    "stylize": "stylization.loop",
    "train": "verbs.train",
    "view": "viewer.view",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{_HOMES[name]}")
    return getattr(module, "rasterize" if name == "render" else name)
