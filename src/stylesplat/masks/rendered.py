"""Photos of a splat that came without any: renders of its views."""

from functools import partial

import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.rendering.render import render
from stylesplat.scene.cache import GIB, Cache, Lazy
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats

KEPT = GIB // 2  # for renders, of which a view has 2 MB


def rendered_capture(scene: Scene, device: torch.device) -> Capture:
    """A capture of a scene: its views, rendered on access, as they look without a style.

    Args:
        scene: What to take photos of.
        device: Where to render.
    """
    splats, cache = scene.unpainted.detach().to(device), Cache[int](KEPT)
    photos = [
        partial(_kept, cache, splats, scene.cameras, row) for row in range(len(scene.cameras))
    ]
    return Capture(scene.cameras, Lazy(photos))


def _kept(cache: Cache[int], splats: Splats, cameras: Cameras, row: int) -> UInt8[Tensor, "H W 3"]:
    (photo,) = cache.get(row, lambda: (_render(splats, cameras[row]),))
    return photo


@torch.no_grad()
def _render(splats: Splats, camera: Cameras) -> UInt8[Tensor, "H W 3"]:
    image = render(splats, camera)[0].clamp(0, 1)
    return (255 * image).round().to(torch.uint8).cpu()
