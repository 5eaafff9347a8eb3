"""Between the camera of a browser and one of ours."""

import math
from collections.abc import Sequence
from typing import Any

import torch

from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.framing import centred_K

PIXELS = 960 * 540  # of a picture at most: more takes longer than anybody waits
NAME = "browser"


def browser_camera(
    wxyz: Sequence[float] | Any,
    position: Sequence[float] | Any,
    fov: float,
    size: tuple[int, int],
    *,
    pixels: int = PIXELS,
) -> Cameras:
    """One camera that sees what a browser shows.

    Args:
        wxyz: The rotation from the camera (OpenCV axes) to the world.
        position: Where it is in the world.
        fov: Radians from the top to the bottom.
        size: Width and height of the browser's picture.
        pixels: How many ours has at most.
    """
    rotation = rotation_matrices(torch.as_tensor(wxyz).double()[None])[0]
    viewmat = torch.eye(4).double()
    viewmat[:3, :3] = rotation.T
    viewmat[:3, 3] = -rotation.T @ torch.as_tensor(position).double()
    width, height = (max(1, round(side)) for side in size)
    focal = height / (2 * math.tan(fov / 2))
    camera = Cameras(
        viewmats=viewmat[None].float(),
        Ks=centred_K(focal, (width, height))[None].float(),
        sizes=torch.tensor([[width, height]]),
        names=(NAME,),
    )
    return camera.downscale(max(1.0, math.sqrt(width * height / pixels)))
