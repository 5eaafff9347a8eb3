"""The server of the studio's page: the page, the socket, files in and out."""

import asyncio
import errno
import re
import secrets
import socket
import threading
from contextlib import suppress
from functools import partial
from itertools import count
from mimetypes import add_type
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import msgspec

from stylesplat.errors import StyleSplatError
from stylesplat.figures.web_page import WEB_PARTS as VIEWER
from stylesplat.progress import write_lines
from stylesplat.studio_app import messages as m
from stylesplat.studio_app.actions import Actions
from stylesplat.studio_app.gallery import GALLERY_PICTURE, MOST_BYTES, too_large
from stylesplat.studio_app.guard import Guard, reachable_address

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp
    from starlette.websockets import WebSocket

SERVER_LARGEST = 2**20  # bytes of a message from a page
SERVER_PAGE = Path(__file__).with_name("page")
add_type("text/javascript", ".js")  # of some systems it is plain text, which no browser runs
PORTS = 100  # that are tried, one after the other
STOP_SECONDS = 10.0
BUSY_AFTER = 0.15  # seconds after which a page is told what it waits for
WARM_UP_AFTER = 2.0  # seconds after a browser has connected, in which its first picture is made


class _Client:
    """A page, and what waits to be sent to it: of each kind only the latest."""

    def __init__(self) -> None:
        self._waiting = dict[object, str | bytes]()
        self._added = asyncio.Event()

    def put(self, kind: object, message: str | bytes) -> None:
        self._waiting.pop(kind, None)
        self._waiting[kind] = message
        self._added.set()

    async def take(self) -> str | bytes:
        while not self._waiting:
            self._added.clear()
            await self._added.wait()
        return self._waiting.pop(next(iter(self._waiting)))


class PageServer:
    def __init__(self, title: str, actions: Actions) -> None:
        self.title, self.actions, self.session = title, actions, actions.session
        self.token = secrets.token_urlsafe(24)
        self.url = ""
        """The address that opens it, with the token."""
        self.port = 0
        self._clients = dict[int, _Client]()
        self._numbers = count(1)
        self._asked = dict[int, int]()
        """The number of what each page asked for last, until it is done."""
        self._uploading = 0  # bytes
        self._loop: asyncio.AbstractEventLoop | None = None
        self._server: Any = None
        self._thread: threading.Thread | None = None
        self.session.on_send.append(self.send)
        self.session.on_change.append(self.send_state)
        self.session.on_progress.append(self.send_progress)
        self.session.on_message.append(self.send_note)

    def start(self, host: str, port: int) -> None:
        """Begin to serve, and print the address with the token on stderr.

        Raises:
            StyleSplatError: If the libraries are not installed, or the address cannot be used.
        """
        try:
            import uvicorn
        except ImportError as error:
            raise StyleSplatError(
                "The studio and the viewer need Starlette and uvicorn, which are not installed. "
                "Run `pip install stylesplat[view]`."
            ) from error
        listening = _listening_socket(host, port)
        self.port = listening.getsockname()[1]
        config = uvicorn.Config(
            Guard(self._app(), self.token, host),
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=SERVER_LARGEST,
            log_config=None,
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        started = threading.Event()

        async def serve() -> None:
            self._loop = asyncio.get_running_loop()
            self._loop.call_soon(started.set)
            await self._server.serve(sockets=[listening])

        run = partial(asyncio.run, serve())
        self._thread = threading.Thread(target=run, name="studio server", daemon=True)
        self._thread.start()
        started.wait(STOP_SECONDS)
        self.url = f"http://{reachable_address(host)}:{self.port}/?token={self.token}"
        write_lines(f"{self.title}: {self.url}")

    def stop(self) -> None:
        if self._server is not None:
            self._server.should_exit = True
        if self._thread is not None:
            self._thread.join(STOP_SECONDS)

    def send(self, client: int, kind: object, message: bytes | m.ServerMessage) -> None:
        """Send a message to a page, from any thread."""
        if isinstance(message, m.ServerMessage):
            content = msgspec.json.encode(message, enc_hook=str).decode()
        else:
            content = message

        def put() -> None:
            if client in self._clients:
                self._clients[client].put(kind, content)

        if self._loop is not None:
            with suppress(RuntimeError):  # it is closed
                self._loop.call_soon_threadsafe(put)

    def broadcast(self, kind: object, message: m.ServerMessage) -> None:
        for client in [*self._clients]:
            self.send(client, kind, message)

    def send_state(self) -> None:
        """Tell all pages the state, in the worker's thread."""
        if self._clients:
            self.broadcast("state", self.actions.state_message())
        self.send_progress()

    def send_progress(self) -> None:
        self.broadcast("progress", self.session.progress or self.session.export or m.Progress())

    def send_note(self, line: str, failure: bool, page: int | None) -> None:
        for client in [*self._clients] if page is None else [page]:
            self.send(client, object(), m.Note(line, failure))  # each is of a kind of its own

    def _app(self) -> "ASGIApp":
        from starlette.applications import Starlette
        from starlette.responses import FileResponse
        from starlette.routing import Mount, Route, WebSocketRoute
        from starlette.staticfiles import StaticFiles

        routes = [
            Route("/", lambda request: FileResponse(SERVER_PAGE / "index.html")),
            Mount("/page", StaticFiles(directory=SERVER_PAGE)),
            Mount("/viewer", StaticFiles(directory=VIEWER)),
            Route("/file/{key}/{name}", self._file),
            Route("/style", self._upload, methods=["POST"]),
            WebSocketRoute("/socket", self._socket),
        ]
        return Starlette(routes=routes)

    async def _file(self, request: "Request") -> "Response":
        from starlette.responses import Response

        found = self.actions.gallery.files.get(request.path_params["key"])
        if found is None:
            return Response("This file is no longer there. Export it again.", status_code=404)
        name, content = found
        if name == GALLERY_PICTURE:
            return Response(content, media_type="image/jpeg")
        headers = {"content-disposition": f"attachment; filename*=utf-8''{quote(name)}"}
        return Response(content, media_type="application/octet-stream", headers=headers)

    async def _upload(self, request: "Request") -> "Response":
        from starlette.responses import PlainTextResponse

        content, name = bytearray(), request.query_params.get("name", "picture")
        if self.actions.readonly:
            return PlainTextResponse("Nothing can be changed here.", status_code=403)
        try:
            async for part in request.stream():
                self._uploading += len(part)
                content += part
                if self._uploading > MOST_BYTES:
                    size = int(request.headers.get("content-length") or self._uploading)
                    return PlainTextResponse(too_large(size), status_code=413)
        finally:
            self._uploading -= len(content)
        added = asyncio.get_running_loop().create_future()
        self.session.ask(lambda: self._add(name, bytes(content), added))
        status, text = await added
        return PlainTextResponse(text, status_code=status)

    def _add(self, name: str, content: bytes, added: "asyncio.Future[tuple[int, str]]") -> None:
        answer = 500, f"{name} could not be added."
        try:
            answer = 200, self.actions.gallery.upload(name, content).title
            self.send_state()
        except StyleSplatError as error:
            answer = 415, str(error)
        finally:
            added.get_loop().call_soon_threadsafe(added.set_result, answer)

    async def _socket(self, socket: "WebSocket") -> None:
        from starlette.websockets import WebSocketDisconnect

        await socket.accept()
        number, client = next(self._numbers), _Client()
        self._clients[number] = client
        self.send(number, "hello", self.actions.hello(self.title))
        self.session.ask(self.send_state, kind="greeting")
        sending = asyncio.create_task(_sending(socket, client))
        if number == 1 and not self.actions.readonly:
            warm_up = partial(self.session.ask, self.actions.warm_up, patient=True)
            asyncio.get_running_loop().call_later(WARM_UP_AFTER, warm_up)
        try:
            while (message := await socket.receive())["type"] == "websocket.receive":
                self._receive(number, message.get("text") or "")
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            sending.cancel()
            del self._clients[number]
            self._asked.pop(number, None)
            self.session.ask(lambda: self.actions.pictures.leave(number))

    def _receive(self, client: int, text: str) -> None:
        try:
            message = self.actions.decoder.decode(text)
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            self.send(client, object(), m.Note(_refusal(str(error)), failure=True))
            return
        if isinstance(message, m.Ping):
            self.send(client, "pong", m.Pong())
            return
        if isinstance(message, m.ViewRequest):
            self.actions.pictures.look(client, message)
            return
        if isinstance(message, m.Interrupt):
            self.session.worker.interrupt(client)
            return
        number = self._asked[client] = next(self._numbers)

        def is_newest() -> bool:
            return self._asked.get(client) == number

        def end() -> None:
            if is_newest():
                self._asked.pop(client, None)
            self.send(client, "busy", m.Busy())

        busy = self.actions.act(client, message, end)

        def tell() -> None:  # not of what a newer action has taken the place of, and never ends
            if is_newest():
                self.send(client, "busy", busy)

        asyncio.get_running_loop().call_later(BUSY_AFTER, tell)


def _refusal(error: str) -> str:
    """What is wrong with a message of a page, from the words of its decoder."""
    limit = re.search(r"(<=|>=|<|>) ([\d.e+-]+).* at `\$\.(\w+)", error)
    if limit is None:
        return "The page and the studio do not understand each other. Reload the page."
    sign, value, field = limit.groups()
    words = {"<=": "at most", ">=": "at least", "<": "less than", ">": "more than"}[sign]
    return f"The {field.replace('_', ' ')} must be {words} {value}. Change it, and try again."


async def _sending(socket: "WebSocket", client: _Client) -> None:
    with suppress(Exception):  # the page is gone
        while True:
            message = await client.take()
            if isinstance(message, bytes):
                await socket.send_bytes(message)
            else:
                await socket.send_text(message)


def _listening_socket(host: str, port: int) -> socket.socket:
    reason = "all ports are in use" if 0 <= port < 2**16 else "ports are from 0 to 65535"
    for number in range(port, min(port + PORTS, 2**16)) if port > 0 else range(port + 1):
        try:
            family, *_ = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
            return socket.create_server((host, number), family=family)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                reason = error.strerror
                break
    raise StyleSplatError(
        f"Cannot serve at {host}:{port}: {reason}. Choose another address or port."
    )
