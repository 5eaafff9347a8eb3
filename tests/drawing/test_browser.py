import http.client
import socket
import sys
from dataclasses import replace
from email.message import Message
from urllib.request import urlopen

import numpy as np
import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.atelier.viewing import pose_of
from stylesplat.drawing.browser import serve
from stylesplat.drawing.client_camera import browser_camera
from stylesplat.drawing.live_splats import covariances, weightiest
from stylesplat.drawing.private_server import is_own, private_server
from stylesplat.errors import StyleSplatError
from stylesplat.signals import Terminated


@pytest.fixture
def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_serves_on_loopback_until_stopped(free_port):
    server = serve(SPLATS, cameras=CAMERAS, port=free_port, block=False)
    try:
        assert (server.get_host(), server.get_port()) == ("127.0.0.1", free_port)
        with urlopen(f"http://127.0.0.1:{free_port}", timeout=10) as page:
            assert b"<html" in page.read().lower()
        position = server.initial_camera.position
        assert np.allclose(position, CAMERAS.positions[0].numpy(), atol=1e-5)
    finally:
        server.stop()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", free_port)) != 0


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 70_000), ("203.0.113.7", 0)])
def test_where_nothing_can_be_served_it_is_told_at_once(host: str, port: int):
    with pytest.raises(StyleSplatError, match=rf"Cannot serve at {host}:{port}: .*Choose another"):
        private_server(port, "balls", host=host, token="secret")


def test_starts_without_cameras(free_port):
    server = serve(SPLATS, port=free_port, block=False)
    try:
        camera = server.initial_camera
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
        with urlopen(f"http://127.0.0.1:{free_port}", timeout=10) as page:
            assert page.status == 200
        raise KeyboardInterrupt

    monkeypatch.setattr("stylesplat.drawing.browser.time.sleep", interrupt)
    serve(SPLATS, port=free_port)
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", free_port)) != 0


def test_sigterm_stops_it_too_and_is_no_normal_end(free_port, monkeypatch):
    def terminate(seconds: float) -> None:
        raise Terminated

    monkeypatch.setattr("stylesplat.drawing.browser.time.sleep", terminate)
    with pytest.raises(Terminated):
        serve(SPLATS, port=free_port)
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", free_port)) != 0


WEBSOCKET = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    "Sec-WebSocket-Protocol": "viser-v1.1.1",
}


def test_only_its_own_pages_are_answered(free_port):
    def status(**headers: str) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", free_port, timeout=10)
        connection.putrequest("GET", "/", skip_host=True)
        for name, value in headers.items():
            connection.putheader(name, value.format(port=free_port))
        connection.endheaders()
        try:
            return connection.getresponse().status
        finally:
            connection.close()

    server = serve(SPLATS, port=free_port, block=False)
    try:
        for host in ("127.0.0.1:{port}", "localhost:{port}"):
            assert status(Host=host) == 200
            assert status(Host=host, **WEBSOCKET) == 101, "programs have no origin"
            assert status(Host=host, Origin="http://" + host, **WEBSOCKET) == 101
            assert status(Host=host, Origin="http://evil.example", **WEBSOCKET) == 403
        for host in ("evil.example:{port}", "127.0.0.1.evil.example", "x@127.0.0.1:{port}"):
            assert status(Host=host) == 403
            assert status(Host=host, Origin="http://" + host, **WEBSOCKET) == 403
        assert status() == 403, "without a host"
    finally:
        server.stop()


@pytest.mark.parametrize(
    ("hosts", "origins", "own"),
    [
        (["[::1]:8080"], [], True),
        (["localhost:9000"], ["http://localhost:9000"], True),  # the near end of a tunnel
        (["localhost:8080"], ["http://localhost:9000"], False),  # another server's page
        (["localhost:8080"], ["http://127.0.0.1:8080"], False),
        (["localhost:8080"], ["null"], False),  # a file, or a frame in a sandbox
        (["localhost:8080", "evil.example"], [], False),
        ([], [], False),
    ],
)
def test_whose_page_it_is(hosts: list[str], origins: list[str], own: bool):
    assert is_own(hosts, origins) == own


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
    with pytest.raises(StyleSplatError, match=f"viser {viser.__version__} answers to other sites"):
        serve(SPLATS, port=free_port)
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
        serve(SPLATS)


def test_empty_splats():
    with pytest.raises(StyleSplatError, match="nothing to view"):
        serve(SPLATS[torch.zeros(len(SPLATS), dtype=torch.bool)])


def test_with_a_token_nobody_else_gets_a_page_or_a_scene(free_port):
    server = private_server(free_port, "test", token="secret")

    def answer(path: str, **headers: str) -> tuple[int, Message, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", free_port, timeout=10)
        try:
            connection.request("GET", path, headers=headers)
            response = connection.getresponse()
            return response.status, response.headers, response.read()
        finally:
            connection.close()

    try:
        for path in ("/", "/?token=wrong", "/index.html"):
            status, _, page = answer(path)
            assert status == 401 and b"token" in page, path
        assert answer("/", **WEBSOCKET)[0] == 401
        assert answer("/", Cookie="stylesplat-token=wrong")[0] == 401
        status, headers, _ = answer("/?token=secret")
        assert (status, headers["Location"]) == (303, "/")
        cookie = headers["Set-Cookie"]
        assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        own = cookie.partition(";")[0]
        assert answer("/", Cookie=own)[0] == 200
        assert answer("/", Cookie=own, Origin="http://elsewhere.example")[0] == 403
    finally:
        server.stop()


def test_of_too_many_gaussians_those_that_show_most_are_sent():
    opacities = torch.linspace(-3, 3, len(SPLATS))
    rows = weightiest(replace(SPLATS, opacities=opacities), 100)
    assert rows is not None and rows.tolist() == [*range(len(SPLATS) - 100, len(SPLATS))]
    assert weightiest(SPLATS, len(SPLATS)) is None


def test_a_browsers_camera_sees_what_ours_does():
    camera = CAMERAS[2]
    wxyz, position, fov = pose_of(camera)
    found = browser_camera(wxyz, position, fov, camera.size)
    assert torch.allclose(found.viewmats, camera.viewmats, atol=1e-5)
    assert torch.allclose(found.Ks, camera.Ks, atol=1e-3) and found.size == camera.size
    large = browser_camera(wxyz, position, fov, (3840, 2160))
    assert large.size == (960, 540)
