"""Two pictures side by side: before and after a style, a photo and its render."""

from collections.abc import Sequence

import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.drawing.best_views import find_views
from stylesplat.drawing.pictures import render_pictures
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.resized import at_most
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.bookkeeping import require_painted
from stylesplat.stylization.undo import unpainted

LONGEST = 2048  # pixels of a side: photos of phones have more than a screen shows
GAP = 8  # white pixels between the pictures


@torch.no_grad()
def before_after(scene: Scene, *, device: str = "auto") -> UInt8[Tensor, "H W 3"] | None:
    """The view that shows most of what was painted on a scene, before and after.

    It is as large as its photo, up to 2048 pixels a side.

    Args:
        scene: A styled scene.
        device: Where to render.

    Returns:
        The pictures side by side; None if no view shows what was painted.

    Raises:
        StyleSplatError: If the scene is not styled.
    """
    base = unpainted(scene).splats.to(pick_device(device))
    picked = require_painted(scene).everything[: len(base)].to(base.device)
    found = find_views(base, scene.cameras, picked, count=1)
    if not found:
        return None
    camera = scene.cameras[found[0].row].at_most(LONGEST)
    return side_by_side([_render(each.to(base.device), camera) for each in (base, scene.splats)])


@torch.no_grad()
def beside_photo(
    scene: Scene, capture: Capture, name: str, *, device: str = "auto"
) -> UInt8[Tensor, "H W 3"]:
    """A photo and what a scene shows there.

    Args:
        scene: Of these photos.
        capture: The photos, at the size to draw them at; sides are at most 2048 pixels.
        name: Of the photo.
        device: Where to render.
    """
    photo = at_most(capture, LONGEST).photos[capture.cameras.index(name)]
    return side_by_side([photo, one_view(scene, name, longest=max(photo.shape), device=device)])


@torch.no_grad()
def one_view(
    scene: Scene, name: str, *, longest: int = LONGEST, device: str = "auto"
) -> UInt8[Tensor, "H W 3"]:
    """What a scene shows in one of its views.

    Args:
        scene: What to look at.
        name: Of the view.
        longest: Pixels of the longer side, if the photo has as many.
        device: Where to render.
    """
    camera = scene.cameras[scene.cameras.index(name)].at_most(longest)
    return _render(scene.splats.to(pick_device(device)), camera)


def side_by_side(pictures: Sequence[UInt8[Tensor, "_ _ 3"]]) -> UInt8[Tensor, "H W 3"]:
    """Pictures from left to right on white, tops aligned."""
    height = max(picture.shape[0] for picture in pictures)
    width = sum(picture.shape[1] + GAP for picture in pictures) - GAP
    sheet = torch.full((height, width, 3), 255, dtype=torch.uint8)
    left = 0
    for picture in pictures:
        sheet[: picture.shape[0], left : left + picture.shape[1]] = picture
        left += picture.shape[1] + GAP
    return sheet


def _render(splats: Splats, camera: Cameras) -> UInt8[Tensor, "H W 3"]:
    return next(iter(render_pictures(splats, camera)))
