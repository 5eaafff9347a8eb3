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
from stylesplat.errors import StyleSplatError
from stylesplat.figures.browser import serve
from stylesplat.figures.client_camera import browser_camera
from stylesplat.figures.live_splats import covariances, weightiest
from stylesplat.figures.private_server import private_server
from stylesplat.signals import Terminated
from stylesplat.studio_app.viewport import viser_pose


@pytest.fixture
def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_serves_on_loopback_until_stopped(free_port):
    server = serve(SPLATS, cameras=CAMERAS, port=free_port, block=False)
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
    server = serve(SPLATS, port=free_port, block=False)
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
    serve(SPLATS, port=free_port)
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", free_port)) != 0


def test_sigterm_stops_it_too_and_is_no_normal_end(free_port, monkeypatch):
    def terminate(seconds: float) -> None:
        raise Terminated

    monkeypatch.setattr("stylesplat.figures.browser.time.sleep", terminate)
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
    server = serve(SPLATS, port=free_port, block=False)
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
    server = serve(SPLATS, port=free_port, block=False)
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
