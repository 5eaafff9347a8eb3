"""A small Hugging Face Hub on this machine: the real library asks it, and raises its own errors."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha1
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from huggingface_hub import constants, hf_api

COMMIT = "5" * 40


@dataclass
class Hub:
    """Serves one model, and fails where it is told to."""

    name: str
    folder: Path
    card: dict[str, Any] = field(default_factory=dict)
    gated: bool = False
    sizes: dict[str, int] = field(default_factory=dict)
    """Bytes that it says files have, if not the truth."""
    status: int = 200
    """Of every answer."""
    breaks: str = ""
    """A file of which half arrives."""
    fetched: list[str] = field(default_factory=list)

    def answer(self, path: str) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body."""
        path = path.partition("?")[0]
        if self.status != 200:
            return self.status, {}, b""
        if f"{self.name}/" not in f"{path}/":
            return 401, {"X-Error-Code": "RepoNotFound"}, b""
        files = {each.name: each for each in self.folder.iterdir()}
        if path in (f"/api/models/{self.name}", f"/api/models/{self.name}/revision/main"):
            siblings = [{"rfilename": name, "size": self._size(name)} for name in files]
            return 200, {}, json.dumps(self._info() | {"siblings": siblings}).encode()
        if path.startswith("/api/"):
            tree = [
                {"type": "file", "path": name, "size": self._size(name), "oid": _etag(name)}
                for name in files
            ]
            return 200, {}, json.dumps(tree).encode()
        if self.gated:
            return 403, {"X-Error-Code": "GatedRepo"}, b""
        name = path.rpartition("/")[2]
        if name not in files:
            return 404, {"X-Error-Code": "EntryNotFound"}, b""
        self.fetched.append(name)
        headers = {"X-Repo-Commit": COMMIT, "ETag": f'"{_etag(name)}"'}
        return 200, headers, files[name].read_bytes()

    def _info(self) -> dict[str, Any]:
        return {"id": self.name, "sha": COMMIT, "gated": self.gated, "cardData": self.card}

    def _size(self, name: str) -> int:
        return self.sizes.get(name, (self.folder / name).stat().st_size)


def _etag(name: str) -> str:
    return sha1(name.encode()).hexdigest()


def point_to(url: str, patch: pytest.MonkeyPatch) -> None:
    """Let the library look for its hub there, as the variable HF_ENDPOINT does at its start."""
    patch.setattr(constants, "ENDPOINT", url)
    patch.setattr(hf_api.api, "endpoint", url)
    template = url + "/{repo_id}/resolve/{revision}/{filename}"
    patch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)


@contextmanager
def serve(hub: Hub, patch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let the library find this hub in the place of the real one."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            status, headers, body = hub.answer(self.path)
            if hub.breaks and self.path.endswith(hub.breaks) and self.command == "GET":
                body = body[: len(body) // 2]
            self.send_response(status)
            for key, value in (headers | {"Content-Length": str(len(body))}).items():
                self.send_header(key, value)
            self.end_headers()
            if self.command == "GET":
                self.wfile.write(body)

        do_HEAD = do_GET

        def log_message(self, format: str, *args: object) -> None:
            pass

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    Thread(target=http.serve_forever, args=(0.01,), daemon=True).start()
    point_to(f"http://127.0.0.1:{http.server_port}", patch)
    try:
        yield
    finally:
        http.shutdown()
        http.server_close()
