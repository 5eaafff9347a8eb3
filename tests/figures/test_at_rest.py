import asyncio
import threading
from collections.abc import Callable, Coroutine, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stylesplat.figures.browser import AtRest
from stylesplat.scene.cameras import Cameras
from stylesplat.work import Worker

Told = Callable[[Any], Coroutine[Any, Any, None]]


class Server:
    """What `AtRest` needs of viser's, with one browser."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        self._joined, self._left = list[Told](), list[Told]()
        self.on_client_connect, self.on_client_disconnect = self._joined.append, self._left.append
        self.scene = SimpleNamespace(add_frame=lambda *_, **__: SimpleNamespace(visible=True))
        self.scene.set_background_image = lambda *_, **__: None
        camera = SimpleNamespace(
            **{"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 0.0), "fov": 1.0},
            **{"image_width": 8, "image_height": 6, "on_update": lambda moved: None},
        )
        self.client = SimpleNamespace(client_id=0, scene=self.scene, camera=camera)

    def get_event_loop(self) -> asyncio.AbstractEventLoop:
        return self._loop

    def join(self) -> None:
        self._tell(self._joined)

    def leave(self) -> None:
        self._tell(self._left)

    def settle(self) -> None:
        """Wait until the loop has done what it was asked for."""
        self._tell([])

    def _tell(self, told: list[Told]) -> None:
        async def tell() -> None:
            for each in told:
                await each(self.client)

        asyncio.run_coroutine_threadsafe(tell(), self._loop).result(30)

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(30)
        self._loop.close()


@pytest.fixture
def server() -> Iterator[Server]:
    found = Server()
    yield found
    found.close()


@pytest.mark.parametrize("leaves", [False, True])
def test_a_browser_that_leaves_while_its_picture_renders_is_forgotten(server: Server, leaves: bool):
    rendered, failures = threading.Event(), list[Exception]()
    worker = Worker(failures.append)

    def look(camera: Cameras) -> np.ndarray:
        if leaves:
            server.leave()
        rendered.set()
        return np.zeros((6, 8, 3), np.uint8)

    rest = AtRest(server, worker, look)  # pyright: ignore[reportArgumentType]
    server.join()
    assert rendered.wait(30) and worker.settle()
    server.settle()
    assert rest.showing(0) != leaves and not failures
    worker.close()
