"""A viewer in the browser: mean colours in motion, the exact picture while the camera rests."""

import asyncio
import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from jaxtyping import UInt8

from stylesplat.errors import StyleSplatError
from stylesplat.figures.live_splats import PARENT, LiveSplats, ViewerSplats, browser_camera
from stylesplat.figures.orbits import first_view
from stylesplat.figures.pictures import BLACK
from stylesplat.figures.private_server import PrivateServer, private_server
from stylesplat.progress import say
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.signals import Terminated
from stylesplat.work import Worker

if TYPE_CHECKING:
    import viser

REST = 0.15  # seconds without motion
DECODED = 0.5  # seconds in which a browser has unpacked a picture
QUALITY = 92  # of the JPEGs
IN_FRONT = 0.02  # world units from the camera: the picture hides the splats; the near plane is 0.01

Look = Callable[[Cameras], UInt8[np.ndarray, "H W 3"]]


class AtRest:
    """Sends exact pictures to the browsers of a server whose cameras rest."""

    def __init__(self, server: "viser.ViserServer", worker: Worker, look: Look) -> None:
        """Start to watch the cameras of all browsers."""
        self._server, self._worker, self._look = server, worker, look
        self._loop = server.get_event_loop()
        self._clients = dict[int, "viser.ClientHandle"]()
        self._splats = dict[int, "viser.FrameHandle"]()
        self._timers = dict[int, asyncio.TimerHandle]()
        self._motions = dict[int, int]()
        self._shown = set[int]()
        self._paper: UInt8[np.ndarray, "H W 3"] | None = None
        self.active = True
        """Whether exact pictures are sent; call `changed` after setting it."""
        self.behind = False
        """Whether pictures lie behind other nodes of the scene; call `changed` after setting it."""
        server.on_client_connect(self._joined)
        server.on_client_disconnect(self._left)

    def changed(self) -> None:
        """Say that the scene has changed, so that all pictures are out of date."""
        self._loop.call_soon_threadsafe(self._all_moved)

    def set_paper(self, color: tuple[float, float, float]) -> None:
        """Set the colour behind the splats while there is no exact picture."""
        self._paper = (255 * np.array(color)).round().astype(np.uint8)[None, None]
        self._server.scene.set_background_image(self._paper, format="png")

    def showing(self, client_id: int) -> bool:
        """Whether a browser shows an exact picture."""
        return client_id in self._shown

    def motion(self, client_id: int) -> int:
        """A number that changes whenever the picture of a browser goes out of date."""
        return self._motions.get(client_id, 0)

    def again(self, client_id: int | None = None, look: Look | None = None) -> None:
        """Replace exact pictures without showing splats between; call it in the worker's thread."""
        for each in [*self._shown] if client_id is None else {client_id} & self._shown:
            self._picture(each, look)

    async def _joined(self, client: "viser.ClientHandle") -> None:
        async def moved(camera: "viser.CameraHandle") -> None:
            self._moved(client.client_id)

        self._clients[client.client_id] = client
        self._splats[client.client_id] = client.scene.add_frame(PARENT, show_axes=False)
        client.camera.on_update(moved)
        self._moved(client.client_id)

    async def _left(self, client: "viser.ClientHandle") -> None:
        self._clients.pop(client.client_id, None)
        self._splats.pop(client.client_id, None)
        self._shown.discard(client.client_id)
        timer = self._timers.pop(client.client_id, None)
        if timer is not None:
            timer.cancel()

    def _all_moved(self) -> None:
        for client_id in self._clients:
            self._moved(client_id)

    def _moved(self, client_id: int) -> None:
        """Take an outdated picture away; runs in the server's event loop."""
        self._motions[client_id] = self._motions.get(client_id, 0) + 1
        if client_id in self._shown:
            self._shown.discard(client_id)
            self._splats[client_id].visible = True
            self._clients[client_id].scene.set_background_image(self._paper, format="png")
        timer = self._timers.pop(client_id, None)
        if timer is not None:
            timer.cancel()
        if self.active:
            self._timers[client_id] = self._loop.call_later(REST, self._rests, client_id)

    def _rests(self, client_id: int) -> None:
        def picture() -> None:
            self._picture(client_id)

        self._worker.ask(picture, kind=f"at rest {client_id}", patient=True)

    def _picture(self, client_id: int, look: Look | None = None) -> None:
        """Render and send one picture; runs in the worker's thread."""
        client, motion = self._clients.get(client_id), self._motions.get(client_id)
        if client is None or not self.active:
            return
        pixels = (look or self._look)(camera_of(client))

        def send() -> None:
            stays = client_id in self._clients and self._motions.get(client_id) == motion
            if self.active and stays:
                near = None if self.behind else np.full((2, 2), IN_FRONT)
                client.scene.set_background_image(pixels, jpeg_quality=QUALITY, depth=near)
                self._shown.add(client_id)
                self._loop.call_later(DECODED, self._hide, client_id, motion)

        self._loop.call_soon_threadsafe(send)

    def _hide(self, client_id: int, motion: int | None) -> None:
        """Stop drawing the splats behind a picture; runs in the server's event loop."""
        if client_id in self._shown and self._motions.get(client_id) == motion:
            self._splats[client_id].visible = False


def camera_of(client: "viser.ClientHandle", **options: int) -> Cameras:
    """The current camera of a browser."""
    camera = client.camera
    size = camera.image_width, camera.image_height
    return browser_camera(camera.wxyz, camera.position, camera.fov, size, **options)


def serve_viewer(
    splats: Splats, *, cameras: Cameras | None = None, port: int = 8080, block: bool = True
) -> PrivateServer:
    """Show splats in a browser: in mean colours, and exactly while the camera rests.

    The server answers only this machine, and only browsers that have the token of its address.

    Args:
        splats: The Gaussians.
        cameras: Cameras of the photos: the viewer starts at the first one and takes the upward
            direction from them. Without them it starts where all content is visible.
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
    shown = ViewerSplats(splats.detach().to("cpu"))
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
    """Wait for Ctrl-C or SIGTERM, then stop the server."""
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
    """Set the initial camera of browsers and the upward direction."""
    view = first_view(splats, cameras)
    server.scene.set_up_direction(view.up.numpy())
    server.initial_camera.fov = 2 * math.atan(view.slopes[1] / 2)
    server.initial_camera.position = view.position.numpy()
    server.initial_camera.look_at = view.target.numpy()
