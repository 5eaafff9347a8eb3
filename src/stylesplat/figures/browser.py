"""Splats in a browser."""

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn

from stylesplat.errors import StyleSplatError
from stylesplat.figures.at_rest import AtRest
from stylesplat.figures.first_view import first_view
from stylesplat.figures.live_splats import LiveSplats
from stylesplat.figures.private_server import PrivateServer, private_server
from stylesplat.figures.shown import Shown
from stylesplat.io.captures.photos import BLACK
from stylesplat.progress import say
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.signals import Terminated
from stylesplat.work import Worker

if TYPE_CHECKING:
    import viser


def serve(
    splats: Splats, *, cameras: Cameras | None = None, port: int = 8080, block: bool = True
) -> PrivateServer:
    """Show splats in a browser: in mean colours, and as they are as soon as the camera rests.

    Only this machine is served, and only browsers that have the token of the printed address.

    Args:
        splats: The Gaussians.
        cameras: Where the photos were taken, to start at the first of them and to know what is
            up; without them all content is in sight, and up is a guess.
        port: Port on 127.0.0.1, or the next free one.
        block: Serve until Ctrl-C; otherwise return at once.

    Returns:
        The running server; its `url` opens it, `stop()` ends it.

    Raises:
        StyleSplatError: If viser is not installed or there is nothing to show.
    """
    refuse_empty(splats)
    opened = private_server(port, "StyleSplat")
    server = opened.server
    shown = Shown(splats.detach().to("cpu"))
    place_camera(server, shown.splats, cameras)
    LiveSplats(server, shown)
    AtRest(server, Worker(_failed), lambda camera: shown.render(camera, BLACK).numpy())
    if block:
        try:
            until_interrupted(opened.stop)
        except Terminated:
            raise
        except KeyboardInterrupt:  # how a viewer is closed
            pass
    return opened


def until_interrupted(stop: Callable[[], object]) -> NoReturn:
    """Wait until Ctrl-C or SIGTERM raises something, and stop what is served."""
    try:
        while True:
            time.sleep(1)
    finally:
        stop()


def refuse_empty(splats: Splats) -> None:
    """Raise a StyleSplatError if there is nothing to show."""
    if not len(splats):
        raise StyleSplatError("These splats are empty, so there is nothing to view.")


def _failed(error: Exception) -> None:
    say(f"No exact picture: {error}")


def place_camera(server: "viser.ViserServer", splats: Splats, cameras: Cameras | None) -> None:
    """Where browsers start, and what is up."""
    view = first_view(splats, cameras)
    server.scene.set_up_direction(view.up.numpy())
    server.initial_camera.fov = 2 * math.atan(view.slopes[1] / 2)
    server.initial_camera.position = view.position.numpy()
    server.initial_camera.look_at = view.target.numpy()
