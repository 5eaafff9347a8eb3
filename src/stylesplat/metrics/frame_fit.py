"""Whether a splat belongs to some photos, and in which world frame."""

from collections.abc import Mapping

import torch

from stylesplat.metrics.psnr import psnr
from stylesplat.rendering.render import render
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import Frame, move_cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats

VIEWS = 5  # that are compared
CHECK_SIZE = 240  # pixels of the longer side: smaller photos are enough for the comparison
CLOSER = 2.0  # dB above the photo's mean colour, from which a splat belongs to the photos


@torch.no_grad()
def frame_fits(splats: Splats, capture: Capture, frames: Mapping[str, Frame]) -> dict[str, float]:
    """How much closer to the photos renders are than their mean colour, in each frame.

    Args:
        splats: The scene.
        capture: Photos, small ones for speed.
        frames: By name, what turns the capture's world into the splat's.

    Returns:
        The median over a few views of the gain in PSNR, in dB; more than `CLOSER` fits.
    """
    rows = evenly(range(len(capture.cameras)), VIEWS)
    photos = [capture.photos[row].to(splats.means) / 255 for row in rows]
    found = {}
    for name, frame in frames.items():
        cameras = move_cameras(capture.cameras[rows], frame)
        gains = []
        for row, photo in enumerate(photos):
            image = render(splats, cameras[row])[0].clamp(0, 1)
            mean_color = photo.mean(dim=(0, 1)).expand_as(photo)
            gains.append(psnr(image, photo) - psnr(mean_color, photo))
        found[name] = float(torch.stack(gains).median())
    return found
