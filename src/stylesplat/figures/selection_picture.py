"""A selection in three views: in colour what takes paint, blue what does not, grey all else."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from PIL import Image
from torch import Tensor

from stylesplat.figures.best_views import Shown, find_views
from stylesplat.figures.compositing import to_uint8
from stylesplat.figures.grid import CAPTION, write_line
from stylesplat.figures.object_sheet import MARGIN, PAPER, TITLE_SIZE
from stylesplat.rendering.render import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import MIN_COVERAGE
from stylesplat.selection.soft_picks import own_shares

PANEL = 480  # pixels along the longer side of a view
DIM = 0.55  # of the brightness of what is not picked
LEFT_OUT = (0.1, 0.35, 1.0)  # the colour of what is picked but takes no paint
OUTLINE, THICKNESS = (255, 200, 0), 2
SPECK = 5  # pixels: what is narrower shows in colour, but an outline would cover it
ROOM = 3.0  # how many times as long as the object a view may be, beyond which it is cut to that
MIN_ROOM = 1 / 6  # of a view, which is never cut to less: one would not know the place


@torch.no_grad()
def selection_picture(
    splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]
) -> UInt8[Tensor, "H W 3"] | None:
    """Draw what is picked in up to three views from different sides, with their names.

    What of it `stylize` leaves as it is, as it lies beside the object or on what this stands on, is
    blue.

    Args:
        splats: The scene.
        cameras: Views to choose from.
        picked: The Gaussians to show.

    Returns:
        The views side by side; None if the picked Gaussians show in none.
    """
    views = find_views(splats, cameras, picked)
    if not views:
        return None
    features = torch.stack([picked.to(splats.means), own_shares(splats, picked, cameras)], dim=1)
    return _row([_panel(splats, _cut(cameras[shown.row], shown), features) for shown in views])


def _panel(
    splats: Splats, camera: Cameras, features: Float[Tensor, "N 2"]
) -> tuple[UInt8[np.ndarray, "_ _ 3"], str]:
    """One view and its name; the features are the pick and the shares of it that take paint."""
    rendered, _ = render(splats, camera, features=features)
    image, covered, own = rendered.split([3, 1, 1], dim=-1)
    grey = DIM * image.mean(dim=-1, keepdim=True)
    left_out = (covered - own) * image.new_tensor(LEFT_OUT)
    panel = to_uint8(own * image + left_out + (1 - covered) * grey).cpu()
    return _outlined(panel, covered[..., 0].cpu() > MIN_COVERAGE), camera.names[0]


def _cut(camera: Cameras, shown: Shown) -> Cameras:
    """The view at a panel's size; around a small object only a part of it."""
    size = camera.sizes[0]
    scale = size / torch.tensor(shown.mask.shape).flip(0)
    places = shown.mask.nonzero().flip(1).cpu()  # x, y
    low, high = places.amin(dim=0) * scale, (places.amax(dim=0) + 1) * scale
    share = (ROOM * ((high - low) / size).max()).clamp(MIN_ROOM, 1)
    zoom = PANEL / (share * size.max())
    wide = (share * size * zoom).round()
    scaled = camera.downscale(1 / float(zoom))
    corner = ((low + high) / 2 * zoom - wide / 2).round().clamp(min=0)
    corner = torch.minimum(corner, (scaled.sizes[0] - wide).clamp(min=0))
    return crop(scaled, corner.tolist(), wide.int().tolist())


def _outlined(
    panel: UInt8[Tensor, "H W 3"], shown: Bool[Tensor, "H W"]
) -> UInt8[np.ndarray, "H W 3"]:
    mask = cv2.medianBlur(shown.numpy().astype(np.uint8), SPECK)
    edges, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(panel.numpy(), edges, -1, OUTLINE, THICKNESS, cv2.LINE_AA)


def _row(panels: Sequence[tuple[UInt8[np.ndarray, "_ _ 3"], str]]) -> UInt8[Tensor, "H W 3"]:
    """Panels side by side, with captions below."""
    height = max(panel.shape[0] for panel, _ in panels)
    width = sum(panel.shape[1] + MARGIN for panel, _ in panels)
    sheet = Image.new("RGB", (width + MARGIN, MARGIN + height + CAPTION), PAPER)
    left = MARGIN
    for panel, caption in panels:
        sheet.paste(Image.fromarray(panel), (left, MARGIN))
        place = (left + 2, MARGIN + panel.shape[0] + 4)
        write_line(sheet, place, caption, TITLE_SIZE, panel.shape[1] - 2)
        left += panel.shape[1] + MARGIN
    return torch.from_numpy(np.array(sheet))
