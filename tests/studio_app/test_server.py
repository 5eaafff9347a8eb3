"""Who may ask the studio's server for what."""

import http.client
import socket
import sys
import threading
import time
from collections.abc import Iterator
from email.message import Message
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import msgspec
import pytest
import torch
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.interrupts import Terminated
from stylesplat.io.scene_folder import save
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.gallery import MOST_BYTES
from stylesplat.studio_app.server import BUSY_AFTER
from stylesplat.studio_app.studio import StudioServer, studio, view

LOOK = {"do": "look", "number": 1, "viewmat": [1.0] * 16, "focal": 50.0, "size": [48, 36]}
WEBSOCKET = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}


@pytest.fixture
def viewer() -> Iterator[StudioServer]:
    found = view(Scene(SPLATS, CAMERAS), port=0, block=False)
    yield found
    found.close()


def answer(
    viewer: StudioServer, path: str, method: str = "GET", **headers: str
) -> tuple[int, Message]:
    """The status and the headers of a response; an empty `Host` sends none."""
    port = viewer.server.port
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.putrequest(method, path, skip_host=True)
    for name, value in ({"Host": f"127.0.0.1:{port}"} | headers).items():
        if value:
            connection.putheader(name, value)
    connection.endheaders()
    try:
        response = connection.getresponse()
        return response.status, response.headers
    finally:
        connection.close()


def test_without_the_token_nobody_gets_a_page_or_a_scene(viewer: StudioServer):
    port, token = viewer.server.port, viewer.server.token
    assert viewer.url == f"http://127.0.0.1:{port}/?token={token}" and len(token) >= 32
    for path in ("/", "/?token=", "/?token=wrong", f"/?token={token[:-1]}", "/page/main.js"):
        assert answer(viewer, path)[0] == 403, path
    for cookie in ("", "stylesplat-token=wrong", f"stylesplat-token-{port}=wrong"):
        assert answer(viewer, "/socket", Cookie=cookie, **WEBSOCKET)[0] == 403
    status, headers = answer(viewer, f"/?token={token}")
    assert status == 200 and headers["Refresh"] == "0; url=/", "the token leaves the address bar"
    own = headers["Set-Cookie"].partition(";")[0]
    assert "HttpOnly" in headers["Set-Cookie"] and "SameSite=Strict" in headers["Set-Cookie"]
    status, headers = answer(viewer, "/page/main.js", Cookie=own)
    assert status == 200 and "default-src 'none'" in headers["Content-Security-Policy"]
    assert answer(viewer, "/socket", Cookie=own, **WEBSOCKET)[0] == 101
    other = own.replace(f"{port}=", "8080=")
    assert answer(viewer, "/", Cookie=other)[0] == 403, "of a server at another port"
    assert answer(viewer, "/", Cookie=f"{other}x; {own}")[0] == 200


def test_other_sites_are_refused_even_with_the_token(viewer: StudioServer):
    path = f"/socket?token={viewer.server.token}"
    for host in (f"127.0.0.1:{viewer.server.port}", "localhost:9000"):  # the near end of a tunnel
        own = {"Host": host, "Origin": f"http://{host}", **WEBSOCKET}
        assert answer(viewer, path, **own)[0] == 101
        secure = own | {"Origin": f"https://{host}", "X-Forwarded-Proto": "https"}
        assert answer(viewer, path, **secure)[0] == 101, "behind a server that encrypts"
        for origin in ("http://evil.example", "http://localhost:9001", "null"):
            assert answer(viewer, path, **own | {"Origin": origin})[0] == 403
    rebound = {"Host": "evil.example", "Origin": "http://evil.example", **WEBSOCKET}
    assert answer(viewer, path, **rebound)[0] == 403
    assert answer(viewer, path, Host="")[0] in (400, 403)
    page = f"/?token={viewer.server.token}"
    for host in ("localhost; script-src *", "127.0.0.1:1 'unsafe-eval'", "[::1"):
        assert answer(viewer, page, Host=host)[0] in (400, 403), host
    secure = {"Host": "[::1]:9000", "X-Forwarded-Proto": "https"}
    status, headers = answer(viewer, page, **secure)
    assert status == 200 and headers["Set-Cookie"].endswith("; Secure")
    assert "wss://[::1]:9000;" in headers["Content-Security-Policy"]


def test_a_server_in_front_may_have_any_name_once_the_address_was_opened_there(
    viewer: StudioServer,
):
    token = viewer.server.token
    front = {"Host": "studio.example", "X-Forwarded-Proto": "https"}
    assert answer(viewer, "/", **front)[0] == 403
    assert answer(viewer, "/?token=wrong", **front)[0] == 403
    assert answer(viewer, f"/page/main.js?token={token}", **front)[0] == 403
    status, headers = answer(viewer, f"/?token={token}", **front)
    assert status == 200 and headers["Refresh"] == "0; url=/"
    front["Cookie"] = headers["Set-Cookie"].partition(";")[0]
    status, headers = answer(viewer, "/", **front)
    assert status == 200 and "wss://studio.example;" in headers["Content-Security-Policy"]
    own = {"Origin": "https://studio.example", **WEBSOCKET}
    assert answer(viewer, "/socket", **front, **own)[0] == 101
    assert answer(viewer, "/socket", **front, **own | {"Origin": "https://x.example"})[0] == 403
    assert answer(viewer, "/socket", **front | {"Cookie": ""}, **own)[0] == 403
    assert answer(viewer, "/", **front | {"Host": "other.example"})[0] == 403


@pytest.mark.parametrize("path", ["/page/../server.py", "/page/%2e%2e/server.py", "/page/none.js"])
def test_nothing_but_the_page_is_served(viewer: StudioServer, path: str):
    assert answer(viewer, f"{path}?token={viewer.server.token}")[0] == 404


@pytest.mark.parametrize(
    "message", ["{", "[]", '{"do": "look"}', '{"do": "fly"}', '{"do": "step"}']
)
def test_a_viewer_changes_nothing_and_survives_what_it_does_not_understand(
    viewer: StudioServer, message: str
):
    url = f"ws://127.0.0.1:{viewer.server.port}/socket?token={viewer.server.token}"
    with connect(url) as client:
        hello = msgspec.json.decode(client.recv(10))
        assert hello["kind"] == "hello" and hello["readonly"]
        client.send(message)
        look = {"do": "look", "number": 3, "focal": 50.0, "size": [48, 36]}
        look["viewmat"] = CAMERAS.viewmats[0].flatten().tolist()
        client.send(msgspec.json.encode(look).decode())
        header = next(h for h in map(header_of, client) if h.get("kind") == "picture")
        assert header["look"] == 3 and header["which"] == "after"
    assert viewer.server.session.worker.wait_until_idle()
    assert len(viewer.server.session.state.note) > 0


@pytest.fixture
def edited(tmp_path: Path) -> Iterator[StudioServer]:
    save(Scene(SPLATS, CAMERAS), tmp_path / "balls")
    found = studio(tmp_path / "balls", port=0, block=False, device="cpu")
    yield found
    found.close()


def test_a_page_learns_what_it_waits_for_and_that_the_server_answers(edited: StudioServer):
    url = f"ws://127.0.0.1:{edited.server.port}/socket?token={edited.server.token}"
    with connect(url) as client:
        assert header_of(client.recv(10))["kind"] == "hello"
        assert edited.session.worker.wait_until_idle()
        waiting = threading.Event()
        edited.session.ask(waiting.wait)
        client.send('{"do": "resize_picked", "share": 0.05}')
        client.send('{"do": "ping"}')
        heard = (header_of(each) for each in client)
        kinds = [each for each in islice(heard, 4) if each["kind"] in ("pong", "busy")]
        waiting.set()
        assert {"kind": "pong"} in kinds
        what = "Growing or shrinking what is picked"
        assert {"kind": "busy", "what": what, "cancel": True} in kinds
        assert next(each for each in heard if each["kind"] == "busy")["what"] == ""


def test_a_page_does_not_wait_for_what_a_newer_action_has_replaced(edited: StudioServer):
    """Of several changes by one slider that wait, the last is made."""
    url = f"ws://127.0.0.1:{edited.server.port}/socket?token={edited.server.token}"
    with connect(url) as client:
        waiting = threading.Event()
        edited.session.ask(waiting.wait)
        for value in (20.0, 40.0):
            change = {"do": "recolor", "names": ["3"], "setting": "hue", "value": value}
            client.send(msgspec.json.encode(change).decode())
        client.send('{"do": "ping"}')
        heard = (header_of(each) for each in client)
        assert any(each["kind"] == "pong" for each in heard), "both have arrived"
        waiting.set()
        assert edited.session.worker.wait_until_idle()
        time.sleep(2 * BUSY_AFTER)
        said = until_pong(client)
        assert [each["what"] for each in said if each["kind"] == "busy"][-1] == ""


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ({"do": "picture", "width": 9000}, "The width must be at most 8192."),
        ({"do": "turntable", "seconds": -1}, "The seconds must be more than 0"),
        ({"do": "resize_picked", "share": "much"}, "Reload the page."),
        ({"do": "pick_box", "low": [1e300, 0, 0], "high": [1, 1, 1]}, "at most 1000000000"),
        ({**LOOK, "focal": 1e-300}, "The focal must be at least 0.001."),
        ({**LOOK, "viewmat": [1e300] * 16}, "at most 1000000000"),
        ({"do": "fly"}, "Reload the page."),
        ({"do": "subtract_picked"}, "Pick two objects or more"),
        ({"do": "pick_names", "names": ["vase"]}, "no object vase any more"),
        ({"do": "hide_objects", "names": ["vase"], "hide": True}, "no object vase any more"),
        ({"do": "turntable", "around": "vase"}, "no object vase any more"),
        ({"do": "export", "ending": ".exe"}, "no format"),
        (b"\0", "Reload the page."),
    ],
)
def test_what_is_wrong_is_told_to_the_page_alone_in_a_sentence(
    edited: StudioServer, message: dict[str, Any] | bytes, words: str
):
    url = f"ws://127.0.0.1:{edited.server.port}/socket?token={edited.server.token}"
    with connect(url) as client, connect(url) as other:
        text = message if isinstance(message, bytes) else msgspec.json.encode(message).decode()
        client.send(text)
        notes = (header_of(each) for each in client)
        text = next(each for each in notes if each["kind"] == "note")["text"]
        assert words in text and "$" not in text and "`" not in text
        edited.session.tell("Painted.")
        texts = [each["text"] for each in until_pong(other) if each["kind"] == "note"]
        assert texts == ["Painted."], "what nobody asked for is told to all"


def until_pong(client: Connection) -> list[dict[str, Any]]:
    """What a page hears until the server answers it."""
    client.send('{"do": "ping"}')
    heard = (header_of(each) for each in client)
    return [*takewhile(lambda each: each["kind"] != "pong", heard)]


def header_of(message: str | bytes) -> dict[str, Any]:
    if isinstance(message, str):
        return msgspec.json.decode(message)
    length = int.from_bytes(message[:4], "little")
    return msgspec.json.decode(message[4 : 4 + length])


def test_a_viewer_takes_no_pictures_and_uploads_are_bounded(viewer: StudioServer):
    path = f"/style?name=a.png&token={viewer.server.token}"
    assert answer(viewer, path, "POST", **{"Content-Length": "0"})[0] == 403
    viewer.server.actions.readonly = False
    connection = http.client.HTTPConnection("127.0.0.1", viewer.server.port, timeout=30)
    connection.request("POST", path, body=bytes(MOST_BYTES + 1))
    response = connection.getresponse()
    assert response.status == 413 and b"40 MB at most" in response.read()
    connection.close()
    assert not viewer.server.actions.gallery.pictures


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 70_000), ("203.0.113.7", 0)])
def test_where_nothing_can_be_served_it_is_told_at_once(viewer: StudioServer, host: str, port: int):
    with pytest.raises(StyleSplatError, match=rf"Cannot serve at {host}:{port}: .*Choose another"):
        viewer.server.start(host, port)


def test_a_port_that_is_taken_leads_to_the_next(viewer: StudioServer):
    other = view(SPLATS, port=viewer.server.port, block=False)
    try:
        assert other.server.port > viewer.server.port
    finally:
        other.close()


@pytest.mark.parametrize("error", [KeyboardInterrupt, Terminated])
def test_it_serves_until_it_is_interrupted(error: type[BaseException], monkeypatch):
    ports = list[int]()

    def interrupt(seconds: float) -> None:
        raise error

    start = StudioServer.__init__

    def started(self: StudioServer, server: Any, store: Any = None) -> None:
        start(self, server, store)
        ports.append(server.port)

    monkeypatch.setattr(StudioServer, "__init__", started)
    monkeypatch.setattr("stylesplat.studio_app.studio.time.sleep", interrupt)
    if error is Terminated:
        with pytest.raises(Terminated):
            view(SPLATS, port=0)
    else:
        view(SPLATS, port=0)
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", ports[0])) != 0


def test_what_cannot_be_viewed_is_told(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(StyleSplatError, match="nothing to view"):
        view(SPLATS[torch.zeros(len(SPLATS), dtype=torch.bool)])
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(StyleSplatError, match=r"pip install stylesplat\[view\]"):
        view(SPLATS)


def test_the_page_names_no_other_server():
    page = Path(__file__).parents[2] / "src/stylesplat/studio_app/page"
    for file in page.iterdir():
        if file.is_file() and file.suffix != ".svg":
            assert "://" not in file.read_text(), file.name
