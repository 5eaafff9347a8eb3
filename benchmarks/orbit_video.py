"""A video of the demo's still life as a phone would take it, with the true camera of each frame."""

from collections.abc import Iterator
from math import tau
from pathlib import Path

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.demo.cloud import surface_points
from stylesplat.demo.still_life import DISTANCE, FOCAL, TARGET, photograph
from stylesplat.io.video import write_video
from stylesplat.progress import track
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.poses import look_at
from stylesplat.scene.sampling import evenly

FPS = 30
HASTE = 0.05  # of a round by which the walk runs ahead and falls behind: 0.4 to 1.6 times the speed
ELEVATIONS = (18.0, 46.0)  # degrees, each reached twice
SHAKY = range(6)  # frames of every second whose shutter is open all the time, in shaking hands
SHAKE = (0.05, 0.03, -0.04)  # by which the aim moves meanwhile: about 7 of 480 pixels
EXPOSURES = 5  # pictures whose mean a shaky frame is
POINTS, POINT_VIEWS = 10_000, 12  # as the demo has


def orbit(
    times: Float[Tensor, " M"], size: tuple[int, int], shakes: Float[Tensor, " M"] | None = None
) -> Cameras:
    """Cameras of one round.

    Args:
        times: From 0 to 1.
        size: Width and height in pixels.
        shakes: How far the aim is off, in units of `SHAKE`; not at all by default.
    """
    angles = tau * (times + HASTE * torch.sin(2 * tau * times))
    low, high = ELEVATIONS
    tilts = torch.deg2rad((low + high) / 2 + (high - low) / 2 * torch.sin(2 * angles))
    level = tilts.cos()
    outward = torch.stack([level * angles.cos(), level * angles.sin(), tilts.sin()], dim=1)
    target, up = torch.tensor(TARGET), torch.tensor([0.0, 0.0, 1.0])
    aims = target.expand(len(times), 3)
    if shakes is not None:
        aims = aims + shakes[:, None] * torch.tensor(SHAKE)
    positions = target + DISTANCE * outward
    (width, height), focal = size, FOCAL * size[0]
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Cameras(
        viewmats=torch.cat(
            [look_at(p[None], aim, up) for p, aim in zip(positions, aims, strict=True)]
        ),
        Ks=K.expand(len(times), 3, 3).clone(),
        sizes=torch.tensor([size]).expand(len(times), 2).clone(),
        names=tuple(f"{i:04d}.png" for i in range(len(times))),
    )


def true_cameras(frames: int, size: tuple[int, int]) -> Cameras:
    """Where each frame was taken from; of a shaky one in the middle of its exposure."""
    return orbit(torch.arange(frames) / frames, size)


def is_shaky(frame: int) -> bool:
    """Whether a frame is blurred by motion."""
    return frame % FPS in SHAKY


def write_orbit(path: Path, frames: int, size: tuple[int, int]) -> None:
    """Trace the video and encode it with H.264."""
    write_video(_frames(frames, size), path, fps=FPS)


def _frames(frames: int, size: tuple[int, int]) -> Iterator[UInt8[Tensor, "H W 3"]]:
    for frame in track(range(frames), "tracing a video"):
        shutter = torch.linspace(-0.5, 0.5, EXPOSURES) if is_shaky(frame) else torch.zeros(1)
        cameras = orbit((frame + shutter) / frames, size, shakes=shutter)
        photos = [view.photo.float() for view in photograph(cameras, 0)]
        yield torch.stack(photos).mean(dim=0).round().to(torch.uint8)


def stills(cameras: Cameras) -> Capture:
    """Sharp photos by true cameras, with points of the true surface."""
    views = list(track(photograph(cameras, 0), "tracing stills", total=len(cameras)))
    chosen = evenly(range(len(cameras)), POINT_VIEWS)
    points, colors = surface_points(cameras[chosen], [views[row] for row in chosen], POINTS)
    photos = [view.photo for view in views]
    return Capture(cameras=cameras, photos=photos, points=points, point_colors=colors)
