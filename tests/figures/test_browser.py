"""Splats in a browser: the server, its token, and exact pictures at rest."""

import asyncio
import http.client
import socket
import sys
import threading
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import replace
from email.message import Message
from types import SimpleNamespace
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
import torch

from balls import CAMERAS, SPLATS
from browser import launched, needs_chromium
from stylesplat.errors import StyleSplatError
from stylesplat.figures.browser import AtRest, serve_viewer
from stylesplat.figures.live_splats import browser_camera, covariances, weightiest
from stylesplat.figures.private_server import private_server
from stylesplat.scene.cameras import Cameras
from stylesplat.signals import Terminated
from stylesplat.studio_app.viewport import viser_pose
from stylesplat.work import Worker


@pytest.fixture
def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_serves_on_loopback_until_stopped(free_port):
    server = serve_viewer(SPLATS, cameras=CAMERAS, port=free_port, block=False)
    try:
        with urlopen(server.url, timeout=10) as page:
            assert b"<html" in page.read().lower()
        position = server.server.initial_camera.position
        assert np.allclose(position, CAMERAS.positions[0].numpy(), atol=1e-5)
    finally:
        server.stop()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", free_port)) != 0


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 70_000), ("203.0.113.7", 0)])
def test_where_nothing_can_be_served_it_is_told_at_once(host: str, port: int):
    with pytest.raises(StyleSplatError, match=rf"Cannot serve at {host}:{port}: .*Choose another"):
        private_server(port, "balls", host=host)


def test_starts_without_cameras(free_port):
    server = serve_viewer(SPLATS, port=free_port, block=False)
    try:
        camera = server.server.initial_camera
        ahead = camera.look_at - camera.position
        ahead /= np.linalg.norm(ahead)
        offsets = SPLATS.means.numpy() - camera.position
        depths = offsets @ ahead
        aside = np.linalg.norm(offsets - depths[:, None] * ahead, axis=1)
        assert depths.min() > 0.3, "outside the balls"
        assert (aside / depths).max() < np.tan(camera.fov / 2) * 4 / 3, "which are in sight"
    finally:
        server.stop()


def test_blocks_until_ctrl_c_and_then_stops(free_port, monkeypatch):
    def interrupt(seconds: float) -> None:
        with socket.socket() as probe:
            assert probe.connect_ex(("127.0.0.1", free_port)) == 0
        raise KeyboardInterrupt

    monkeypatch.setattr("stylesplat.figures.browser.time.sleep", interrupt)
    serve_viewer(SPLATS, port=free_port)
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", free_port)) != 0


def test_sigterm_stops_it_too_and_is_no_normal_end(free_port, monkeypatch):
    def terminate(seconds: float) -> None:
        raise Terminated

    monkeypatch.setattr("stylesplat.figures.browser.time.sleep", terminate)
    with pytest.raises(Terminated):
        serve_viewer(SPLATS, port=free_port)
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", free_port)) != 0


WEBSOCKET = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    "Sec-WebSocket-Protocol": "viser-v1.1.1",
}


def answer(port: int, path: str, **headers: str) -> tuple[int, Message]:
    """The status and the headers of a response; an empty `Host` sends none."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in ({"Host": f"127.0.0.1:{port}"} | headers).items():
        if value:
            connection.putheader(name, value)
    connection.endheaders()
    try:
        response = connection.getresponse()
        return response.status, response.headers
    finally:
        connection.close()


def test_without_the_token_nobody_gets_a_page_or_a_scene(free_port, capsys):
    server = serve_viewer(SPLATS, port=free_port, block=False)
    try:
        assert capsys.readouterr() == ("", f"StyleSplat: {server.url}\n")
        origin, _, secret = server.url.partition("/?token=")
        assert origin == f"http://127.0.0.1:{free_port}" and len(secret) >= 32
        for path in ("/", "/?token=", "/?token=wrong", f"/?token={secret[:-1]}", "/index.html"):
            assert answer(free_port, path)[0] == 403, path
            assert answer(free_port, path, **WEBSOCKET)[0] == 403, path
        for name in ("stylesplat-token", f"stylesplat-token-{free_port}"):
            assert answer(free_port, "/", Cookie=f"{name}=wrong", **WEBSOCKET)[0] == 403
        assert answer(free_port, f"/?token={secret}", **WEBSOCKET)[0] == 101, "of a program"
        status, headers = answer(free_port, f"/?token={secret}")
        assert status == 200
        cookie = headers["Set-Cookie"]
        assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        own = cookie.partition(";")[0]
        assert answer(free_port, "/", Cookie=own)[0] == 200
        assert answer(free_port, "/", Cookie=own, **WEBSOCKET)[0] == 101
        other = own.replace(f"{free_port}=", "8080=")
        assert answer(free_port, "/", Cookie=other)[0] == 403, "of a server at another port"
        assert answer(free_port, "/", Cookie=f"{other}x; {own}")[0] == 200
    finally:
        server.stop()


def test_other_sites_are_refused_even_with_the_token(free_port):
    server = serve_viewer(SPLATS, port=free_port, block=False)
    path = server.url.removeprefix(f"http://127.0.0.1:{free_port}")
    try:
        for host in (f"127.0.0.1:{free_port}", "localhost:9000"):  # the near end of a tunnel
            own = {"Host": host, "Origin": f"http://{host}", **WEBSOCKET}
            assert answer(free_port, path, **own)[0] == 101
            for origin in ("http://evil.example", "http://localhost:9001", "null"):
                assert answer(free_port, path, **own | {"Origin": origin})[0] == 403
        assert answer(free_port, path, Host="")[0] == 403
    finally:
        server.stop()


def test_a_viser_that_cannot_be_guarded_is_refused(free_port, monkeypatch):
    import viser
    from websockets.asyncio.server import serve as other_way

    infra = sys.modules["viser.infra._infra"]
    library = type(sys)("asyncio")
    library.server = type(sys)("server")  # pyright: ignore
    library.server.serve = other_way  # pyright: ignore
    websockets = type(sys)("websockets")
    websockets.__dict__.update(infra.websockets.__dict__, asyncio=library)  # pyright: ignore
    monkeypatch.setattr(infra, "websockets", websockets)
    with pytest.raises(StyleSplatError, match=f"viser {viser.__version__} answers everybody"):
        serve_viewer(SPLATS, port=free_port)
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", free_port)) != 0


def test_covariances_have_the_scales_as_deviations():
    quats = torch.randn(len(SPLATS), 4, generator=torch.Generator().manual_seed(0))
    scales = torch.tensor([-1.0, -2.0, -3.0]).expand(len(SPLATS), 3)
    covars = covariances(replace(SPLATS, quats=quats, scales=scales))
    deviations = torch.linalg.eigvalsh(covars).sqrt()  # ascending
    assert torch.allclose(deviations, scales.flip(-1).exp(), rtol=1e-3)


def test_without_viser(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(StyleSplatError, match=r"pip install stylesplat\[view\]"):
        serve_viewer(SPLATS)


def test_empty_splats():
    with pytest.raises(StyleSplatError, match="nothing to view"):
        serve_viewer(SPLATS[torch.zeros(len(SPLATS), dtype=torch.bool)])


def test_of_too_many_gaussians_those_that_show_most_are_sent():
    opacities = torch.linspace(-3, 3, len(SPLATS))
    rows = weightiest(replace(SPLATS, opacities=opacities), 100)
    assert rows is not None and rows.tolist() == [*range(len(SPLATS) - 100, len(SPLATS))]
    assert weightiest(SPLATS, len(SPLATS)) is None


def test_a_browsers_camera_sees_what_ours_does():
    camera = CAMERAS[2]
    wxyz, position, fov = viser_pose(camera)
    found = browser_camera(wxyz, position, fov, camera.size)
    assert torch.allclose(found.viewmats, camera.viewmats, atol=1e-5)
    assert torch.allclose(found.Ks, camera.Ks, atol=1e-3) and found.size == camera.size
    large = browser_camera(wxyz, position, fov, (3840, 2160))
    assert large.size == (960, 540)


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


SAID = "(document.body && document.body.innerText) || ''"


@needs_chromium
def test_a_browser_without_webgl_is_told_what_helps():
    """By viser's own page."""
    server = serve_viewer(SPLATS, cameras=CAMERAS, port=0, block=False)
    try:
        with launched(600, 400, "--disable-3d-apis") as page:
            page.open(server.url)
            page.until(f"({SAID}).includes('WebGL is unavailable')")
            assert "hardware acceleration" in page.evaluate(SAID)
    finally:
        server.stop()
