"""How close images are to others: PSNR, SSIM, and whether a splat shows what photos show."""

from collections.abc import Mapping
from functools import lru_cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import conv2d

from stylesplat.rendering.render import render
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import Frame, move_cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats

SMALLEST_ERROR = 1e-12  # a mean square below float32's rounding counts as this: 120 dB
# SSIM after Wang et al. 2004, as the 3D Gaussian splatting code computes it
WINDOW = 11  # pixels
SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2
# A splat compared with photos
VIEWS = 5  # that are compared
CHECK_SIZE = 240  # pixels of the longer side: smaller photos are enough for the comparison
CLOSER = 2.0  # dB above the photo's mean colour, from which a splat belongs to the photos


def psnr(image: Float[Tensor, "..."], target: Float[Tensor, "..."]) -> Float[Tensor, ""]:
    """Peak signal-to-noise ratio in decibels of images in 0..1, 120 at most."""
    return decibels((image - target).square().mean())


def decibels(error: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """A mean squared error of images in 0..1 as PSNR."""
    return -10 * error.clamp(min=SMALLEST_ERROR).log10()


@lru_cache
@torch.inference_mode(False)  # else training could not use them later
def ssim_window(device: torch.device) -> Float[Tensor, " 11"]:
    x = torch.arange(WINDOW) - WINDOW // 2
    window = torch.exp(-(x**2) / (2 * SIGMA**2))
    return (window / window.sum()).to(device)


def ssim(
    image: Float[Tensor, "H W 3"],
    target: Float[Tensor, "H W 3"],
    valid: Bool[Tensor, "H W"] | None = None,
) -> Float[Tensor, ""]:
    """Mean structural similarity of two images in 0..1, zero-padded as in the 3DGS code.

    Of the valid pixels, if some are not: in the windows around them the others are black.
    """
    x, y = (each.permute(2, 0, 1) for each in (image, target))
    if valid is None:
        return ssim_map(x, y).mean()
    return ssim_map(x * valid, y * valid)[:, valid].mean()


def ssim_map(
    image: Float[Tensor, "D H W"], target: Float[Tensor, "D H W"]
) -> Float[Tensor, "D H W"]:
    """The structural similarity around each pixel, channel by channel."""
    x, y = image.contiguous(), target.contiguous()
    maps = torch.cat([x, y, x * x, y * y, x * y])[None]  # [1, 5 D, H, W]
    count, window = maps.shape[1], ssim_window(image.device).to(image)
    # One group per map: on a GPU, cuDNN would round what goes into other convolutions to TF32
    rows = window.view(1, 1, -1, 1).expand(count, -1, -1, -1)
    columns = window.view(1, 1, 1, -1).expand(count, -1, -1, -1)
    maps = conv2d(maps, rows, padding=(WINDOW // 2, 0), groups=count)
    maps = conv2d(maps, columns, padding=(0, WINDOW // 2), groups=count)
    mean_x, mean_y, xx, yy, xy = maps[0].chunk(5)
    var_x, var_y, covar = xx - mean_x**2, yy - mean_y**2, xy - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return luminance * (2 * covar + C2) / (var_x + var_y + C2)


@torch.no_grad()
def frame_fits(splats: Splats, capture: Capture, frames: Mapping[str, Frame]) -> dict[str, float]:
    """How much closer to the photos renders are than their mean colour, in each frame.

    A frame turns the capture's world into the splat's. Returns the median over a few views of the
    gain in PSNR, in dB; more than `CLOSER` fits. Small photos are enough.
    """
    rows = evenly(range(len(capture.cameras)), VIEWS)
    photos = [capture.photos[row].to(splats.means) / 255 for row in rows]
    found = {}
    for name, frame in frames.items():
        cameras = move_cameras(capture.cameras[rows], frame)
        gains = []
        for row, photo in enumerate(photos):
            valid = capture.valid(rows[row])
            image = render(splats, cameras[row])[0].clamp(0, 1).flatten(0, 1)
            kept = slice(None) if valid is None else valid.flatten().to(image.device)
            image, photo = image[kept], photo.flatten(0, 1)[kept]
            gains.append(psnr(image, photo) - psnr(photo.mean(dim=0).expand_as(photo), photo))
        found[name] = float(torch.stack(gains).median())
    return found
