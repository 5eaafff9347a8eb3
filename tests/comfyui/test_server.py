"""The example workflow in a server of ComfyUI: COMFYUI names its checkout (see `comfy_host`)."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import Request, urlopen

import pytest
import torch
from PIL import Image

import stylesplat as ss
from balls import dense_ball
from comfy_host import COMFYUI, FOLDER, prompt_of

pytestmark = pytest.mark.skipif(COMFYUI is None, reason="COMFYUI names no checkout of ComfyUI")
START, PAINT = 120, 200  # seconds
# What releases before June 2026 lack
TYPES = """
import sys
sys.path.append({tests!r})
import comfy_host
from comfy_api.latest import Types
for each in (comfy_host.SPLAT, comfy_host.File3D):
    if not hasattr(Types, each.__name__):
        setattr(Types, each.__name__, each)
"""


class Server:
    """A server that runs."""

    def __init__(self, port: int) -> None:
        self.address = f"http://127.0.0.1:{port}"

    def ask(self, path: str, data: dict[str, Any] | None = None) -> Any:
        body = None if data is None else json.dumps(data).encode()
        headers = {"Content-Type": "application/json"}
        with urlopen(Request(self.address + path, body, headers), timeout=30) as answer:
            content = answer.read()
        return json.loads(content) if content else None

    def start(self, prompt: dict[str, Any]) -> str:
        return self.ask("/prompt", {"prompt": prompt})["prompt_id"]

    def wait(self, prompt_id: str) -> dict[str, Any]:
        for _ in range(PAINT):
            if prompt_id in (history := self.ask(f"/history/{prompt_id}")):
                return history[prompt_id]
            time.sleep(1)
        raise AssertionError("the prompt does not end")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("ComfyUI")
    nodes = root / "custom_nodes"
    (nodes / "types").mkdir(parents=True)
    types = TYPES.format(tests=str(Path(__file__).parents[1]))
    (nodes / "types" / "prestartup_script.py").write_text(types)
    shutil.copytree(FOLDER, nodes / "stylesplat")
    for name in ("input", "output", "models", "user", "temp"):
        (root / name).mkdir()
    ss.export(dense_ball(torch.ones(1500, 3)), root / "input" / "still_life.ply")
    pixels = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(2))
    Image.fromarray((255 * pixels).byte().numpy()).save(root / "input" / "wave.jpg")
    return root


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[Server]:
    assert COMFYUI is not None
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "main.py", "--cpu", "--port", port, "--base-directory", folder]
    path = os.pathsep.join(sys.path)
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            [str(word) for word in command],
            cwd=COMFYUI,
            env={**os.environ, "PYTHONPATH": path},
            stdout=log,
            stderr=log,
        )
        try:
            found = Server(port)
            for _ in range(START):
                assert process.poll() is None, (folder / "log").read_text()[-2000:]
                try:
                    found.ask("/queue")
                    break
                except URLError:
                    time.sleep(1)
            yield found
        finally:
            process.terminate()
            process.wait(timeout=30)


@pytest.fixture
def prompt(server: Server) -> dict[str, Any]:
    from comfy_host import schema_of_server

    path = FOLDER / "example_workflows" / "paint_an_object.json"
    return prompt_of(json.loads(path.read_text()), schema_of_server(server.ask("/object_info")))


def test_the_workflow_runs(server: Server, prompt: dict[str, Any], folder: Path):
    prompt["4"]["inputs"]["quality"] = "draft"
    done = server.wait(server.start(prompt))
    assert done["status"]["status_str"] == "success", done["status"]["messages"][-1]
    (file,) = (folder / "output" / "3d").glob("StyleSplat_*.ply")
    assert len(ss.import_(file).base) >= 1500
    assert {*done["outputs"]} == {"6", "8", "9"}


def test_cancel_ends_painting(server: Server, prompt: dict[str, Any], folder: Path):
    prompt["4"]["inputs"] |= {"quality": "high", "seed": 1}
    number = server.start(prompt)
    for _ in range(START):
        if "Stylize" in str(server.ask("/queue")["queue_running"]):
            break
        time.sleep(0.2)
    time.sleep(5)
    began = time.monotonic()
    server.ask("/interrupt", {})
    done = server.wait(number)
    assert done["status"]["messages"][-1][0] == "execution_interrupted"
    assert time.monotonic() - began < 20
