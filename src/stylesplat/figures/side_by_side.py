"""Two pictures side by side: before and after a style, a photo and its render."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image
from torch import Tensor

from stylesplat.figures.best_views import (
    SEARCHED_VIEWS,
    find_views,
    most_detailed,
    surveyed_views,
)
from stylesplat.figures.grid import write_line
from stylesplat.figures.object_sheet import TITLE_SIZE
from stylesplat.figures.pictures import render_pictures
from stylesplat.io.captures.capture_folder import open_capture
from stylesplat.metrics.psnr import psnr
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.compose import require_painted
from stylesplat.scene.resized import at_most
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import Box

LONGEST = 2048  # pixels of a side: photos of phones have more than a screen shows
GAP = 8  # white pixels between the pictures
NARROWEST = 450  # pixels of a picture's width, so that two of them can be looked at
LINE = 40  # letters' heights that a picture is wide


@torch.no_grad()
def before_after(
    scene: Scene,
    *,
    surveys: Mapping[str, Sequence[Box]] | None = None,
    device: str = "auto",
) -> tuple[str, UInt8[Tensor, "H W 3"]] | None:
    """The view that shows most of what was painted on a scene and of its detail, before and after.

    It is as large as its photo, up to 2048 pixels a side.

    Args:
        scene: A styled scene.
        surveys: Where each painted object shows, if that is known; of other painted objects
            the view need not show anything.
        device: Where to render.

    Returns:
        The view's name and the pictures side by side; None if no view shows what was painted.

    Raises:
        StyleSplatError: If the scene is not styled.
    """
    require_painted(scene)
    base = scene.unpainted.to(pick_device(device))
    picked = torch.zeros(len(base), dtype=torch.bool, device=base.device)
    for layer in scene.layers:
        picked[layer.rows.to(base.device)] = True
    if surveys is None:
        found = find_views(base, scene.cameras, picked, count=SEARCHED_VIEWS)
    else:
        found = surveyed_views(surveys.values(), scene.cameras, count=SEARCHED_VIEWS)
    if not found:
        return None
    camera = scene.cameras[most_detailed(base, scene.cameras, found).row].at_most(LONGEST)
    pair = [_render(each.to(base.device), camera) for each in (base, scene.splats)]
    return camera.names[0], side_by_side(pair)


@torch.no_grad()
def beside_photo(
    scene: Scene, capture: Capture, name: str, *, device: str = "auto"
) -> UInt8[Tensor, "H W 3"]:
    """A photo and what a scene shows there, with what they are and how close below them.

    They are drawn at the photo's own size, though the capture may be loaded at a smaller one, up
    to 2048 pixels a side and no narrower than 450. How close they are is measured at the size of
    the capture.

    Args:
        scene: Of these photos.
        capture: The photos, at the size that the scene was made from.
        name: Of the photo.
        device: Where to render.

    Raises:
        StyleSplatError: If the photos cannot be read again at their own size.
    """
    whole = capture
    if capture.downscale != 1 and capture.path is not None:
        whole = open_capture(capture.path, masks=False).at(1.0)
    splats = scene.splats.to(pick_device(device))
    photo, render = _pair(scene, splats, at_most(whole, LONGEST), name)
    close = psnr(*(each / 255 for each in _pair(scene, splats, capture, name)))
    held_out = "held-out " * (name in scene.held_out)
    captions = f"{held_out}photo {name}", f"render, PSNR {float(close):.1f} dB"
    return side_by_side([*map(_captioned, (photo, render), captions)])


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


def _pair(
    scene: Scene, splats: Splats, capture: Capture, name: str
) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W 3"]]:
    """A photo, and the render of its view as the scene has it, as large."""
    row, own = capture.cameras.index(name), scene.cameras[scene.cameras.index(name)]
    camera = replace(capture.cameras[row], viewmats=own.viewmats)
    return capture.photos[row], _render(splats, camera)


def _captioned(picture: UInt8[Tensor, "h w 3"], text: str) -> UInt8[Tensor, "H W 3"]:
    """A picture that is wide enough to read the line below it."""
    image = Image.fromarray(picture.numpy())
    if image.width < NARROWEST:
        height = round(image.height * NARROWEST / image.width)
        image = image.resize((NARROWEST, height), Image.Resampling.BICUBIC)
    size = max(TITLE_SIZE, image.width // LINE)
    sheet = Image.new("RGB", (image.width, image.height + size + GAP), "white")
    sheet.paste(image)
    write_line(sheet, (GAP, image.height), text, size, image.width - GAP)
    return torch.from_numpy(np.array(sheet))
