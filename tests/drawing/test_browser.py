import socket
import sys
from dataclasses import replace
from urllib.request import urlopen

import numpy as np
import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.drawing.browser import covariances, serve
from stylesplat.errors import StyleSplatError


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


def test_starts_without_cameras(free_port):
    server = serve(SPLATS, port=free_port, block=False)
    try:
        distance = np.linalg.norm(server.initial_camera.position - server.initial_camera.look_at)
        assert distance > 1  # outside the balls
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
