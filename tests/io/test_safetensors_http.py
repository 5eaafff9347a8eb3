import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
import torch
from safetensors.torch import save

from stylesplat.errors import StyleSplatError
from stylesplat.io.hub import fetch_tensors
from stylesplat.stylization import features as weights
from stylesplat.stylization.features import load_weights


@dataclass
class Server:
    """Serves `content`, in parts if it is told to, and counts what it sends."""

    content: bytes
    ranges: bool = True
    sent: list[int] = field(default_factory=list)
    url: str = ""


def tensors() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return {
        "classifier.weight": torch.zeros(1000, 1000),
        "features.0.bias": torch.randn(64, generator=generator),
        "features.0.weight": torch.randn(64, 3, 3, 3, generator=generator),
        "features.2.bias": torch.randn(64, generator=generator),
        "features.2.weight": torch.randn(64, 64, 3, 3, generator=generator).half(),
    }


@pytest.fixture
def server() -> Iterator[Server]:
    serving = Server(save(tensors()))

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers["Range"])
            assert asked is not None
            begin, end = int(asked[1]), int(asked[2]) + 1
            body = serving.content[begin:end] if serving.ranges else serving.content
            serving.sent.append(len(body))  # before the client has it all
            self.send_response(206 if serving.ranges else 200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            if serving.ranges:
                self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            pass

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    serving.url = f"http://127.0.0.1:{http.server_port}/model.safetensors"
    thread = Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield serving
    http.shutdown()
    http.server_close()
    thread.join()


@pytest.fixture
def no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    return tmp_path


def test_only_the_tensors_asked_for_travel(server: Server):
    names = ["features.2.weight", "features.0.bias"]
    fetched = fetch_tensors(server.url, names, title="test")
    assert list(fetched) == names
    for name in names:
        assert torch.equal(fetched[name], tensors()[name].float())
    assert sum(server.sent) < 1e5 < len(server.content)


def test_first_use_downloads_and_later_ones_do_not(
    server: Server,
    no_cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    said: list[str],
):
    monkeypatch.setattr(weights, "HUB_URL", server.url)
    first = load_weights("vgg16", depth=1)
    requests = len(server.sent)
    assert f"Downloading vgg16's convolutions from {server.url}" in said.pop()
    again = load_weights("vgg16", depth=1)
    assert len(server.sent) == requests
    assert said == []
    assert torch.equal(first.blocks[0][1].weight, tensors()["features.2.weight"].float())
    assert torch.equal(first.blocks[0][1].weight, again.blocks[0][1].weight)
    cached = [p.name for p in (no_cache / "hub" / "checkpoints").iterdir()]
    assert cached == ["vgg16_to_block1.safetensors"]


def test_offline(no_cache: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(weights, "HUB_URL", "http://127.0.0.1:1/model.safetensors")
    with pytest.raises(StyleSplatError, match=r"Cannot download .* `--weights FILE`") as error:
        load_weights("vgg19")
    assert "\n" not in str(error.value)
    assert not (no_cache / "hub").exists()


HEADER = json.dumps({"x": {"dtype": "I64", "shape": [1], "data_offsets": [0, 8]}}).encode()


INTEGERS = len(HEADER).to_bytes(8, "little") + HEADER + bytes(8)


@pytest.mark.parametrize(
    ("content", "name", "ranges", "match"),
    [
        (save(tensors())[:-9], "features.2.weight", True, "the connection broke off"),
        (b"<html>not found, but politely</html>", "x", True, "Cannot download from"),
        (b"\2" + b"\0" * 9, "x", True, "Cannot download from"),
        (INTEGERS, "features.2.weight", True, r"lacks features\.2\.weight"),
        (INTEGERS, "x", True, "Cannot download from"),
        (INTEGERS, "x", False, "the server sends whole files only"),
    ],
    ids=range(6),
)
def test_what_cannot_be_read(server: Server, content: bytes, name: str, ranges: bool, match: str):
    server.content, server.ranges = content, ranges
    with pytest.raises(StyleSplatError, match=match):
        fetch_tensors(server.url, [name], title="test")
