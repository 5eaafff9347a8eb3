"""Splats in a browser."""

import math
import time
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.drawing.first_view import first_view
from stylesplat.drawing.private_server import private_server
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.sh import rgb_from_sh0
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.signals import Terminated

if TYPE_CHECKING:
    import viser


def serve(
    splats: Splats, *, cameras: Cameras | None = None, port: int = 8080, block: bool = True
) -> "viser.ViserServer":
    """Show splats in a browser, in their mean colours (spherical harmonics of degree 0).

    Only this machine is served, and only the server's own pages: other sites cannot read along.

    Args:
        splats: The Gaussians.
        cameras: Where the photos were taken, to start at the first of them and to know what is
            up; without them all content is in sight, and up is a guess.
        port: Port on 127.0.0.1, or the next free one.
        block: Serve until Ctrl-C; otherwise return at once.

    Returns:
        The running server; `stop()` ends it.

    Raises:
        StyleSplatError: If viser is not installed or there is nothing to show.
    """
    if not len(splats):
        raise StyleSplatError("These splats are empty, so there is nothing to view.")
    server = private_server(port, "StyleSplat")
    splats = splats.detach().to("cpu")
    _add_splats(server, splats)
    _place_camera(server, splats, cameras)
    if block:
        _serve_until_interrupted(server)
    return server


def covariances(splats: Splats) -> Float[Tensor, "N 3 3"]:
    """World covariance of each Gaussian."""
    axes = rotation_matrices(splats.quats) * splats.scales.exp()[:, None]
    return axes @ axes.mT


def _add_splats(server: "viser.ViserServer", splats: Splats) -> None:
    server.scene.add_gaussian_splats(
        "/splats",
        centers=splats.means.numpy(),
        covariances=covariances(splats).numpy(),
        rgbs=rgb_from_sh0(splats.sh0[:, 0]).clamp(0, 1).numpy(),
        opacities=torch.sigmoid(splats.opacities)[:, None].numpy(),
    )


def _place_camera(server: "viser.ViserServer", splats: Splats, cameras: Cameras | None) -> None:
    view = first_view(splats, cameras)
    server.scene.set_up_direction(view.up.numpy())
    server.initial_camera.fov = 2 * math.atan(view.slopes[1] / 2)
    server.initial_camera.position = view.position.numpy()
    server.initial_camera.look_at = view.target.numpy()


def _serve_until_interrupted(server: "viser.ViserServer") -> None:
    try:
        while True:
            time.sleep(1)
    except Terminated:
        raise
    except KeyboardInterrupt:  # how a viewer is closed
        pass
    finally:
        server.stop()
