"""A viser server that only its own pages may talk to.

Any site can make a browser send requests to this machine: under a name of its own that it lets
point here (DNS rebinding), which `Host` then tells; and over websockets, which browsers open to
everywhere, telling the site as `Origin`. Either could read the splat.
"""

import errno
import hmac
import re
import socket
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    import viser
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

ADDRESS = "127.0.0.1"  # a splat may show somebody's home: never offer it to the network
OWN = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?")  # at any port: of a tunnel too
REFUSAL = (
    "This server answers its own pages only. Open it as http://localhost:PORT, from elsewhere by "
    "way of an SSH tunnel.\n"
)
COOKIE = "stylesplat-token"
LARGEST = 4 * 2**20  # bytes of what a page sends at once; files come in parts of half a MB
ASKING = """<!doctype html><html lang="en"><meta charset="utf-8"><title>StyleSplat</title>
<body style="font: 16px system-ui; background: #161618; color: #e6e6e8; display: grid;
place-content: center; height: 90vh"><form method="get"><h1>StyleSplat</h1>
<p>This studio asks for the token that its terminal shows.</p>
<input name="token" autofocus autocomplete="off" style="font: inherit; padding: 6px; width: 22em">
<button style="font: inherit; padding: 6px 14px">Open</button></form></body></html>
"""


def private_server(
    port: int, label: str, *, host: str = ADDRESS, token: str | None = None
) -> "viser.ViserServer":
    """Serve on this machine alone, to pages of this server alone; or to those who have a token.

    Args:
        port: Port, or the next free one.
        label: Title of the page.
        host: The address to serve at; others than 127.0.0.1 need a token.
        token: What everybody is asked for before anything is sent; None asks nobody.

    Raises:
        StyleSplatError: If viser is not installed, or does not let others be refused, or there is
            no such address or port, or none that may be taken.
    """
    try:
        import viser
    except ImportError as error:
        raise StyleSplatError(
            "The viewer needs viser, which is not installed. Run `pip install stylesplat[view]`."
        ) from error
    from websockets.asyncio import server as library

    assert token or host == ADDRESS  # never to a network without one
    _refuse_address(host, port)
    serve, guarded = library.serve, list[bool]()
    guard = _own_only if token is None else partial(_with_token, token)

    def serve_own(*args: Any, process_request: Any = None, **options: Any) -> Any:
        guarded.append(True)
        options["max_size"] = LARGEST
        return serve(*args, process_request=guard(process_request), **options)

    library.serve = serve_own  # viser has no hook; it has called this when it is made
    try:
        server = viser.ViserServer(host=host, port=port, label=label)
    finally:
        library.serve = serve
    if not guarded:
        server.stop()
        raise StyleSplatError(
            f"viser {viser.__version__} answers to other sites too. Run `pip install viser==1.1.1`."
        )
    return server


def _refuse_address(host: str, port: int) -> None:
    """Raise a StyleSplatError where nothing can be served; viser would wait for ever."""
    try:
        family, *_ = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except (OSError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) else "ports are from 0 to 65535"
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            return  # viser takes the next one
        raise StyleSplatError(
            f"Cannot serve at {host}:{port}: {reason}. Choose another address or port."
        ) from error


def is_own(hosts: list[str], origins: list[str]) -> bool:
    """Whether a request with these headers comes from a page of this server, or from no page."""
    if len(hosts) != 1 or not OWN.fullmatch(hosts[0]):
        return False
    return origins in ([], [f"http://{hosts[0]}"])


def _own_only(process_request: Callable[..., Any] | None) -> Callable[..., Any]:
    def checked(connection: "ServerConnection", request: "Request") -> "Response | Any":
        headers = request.headers
        if not is_own(headers.get_all("Host"), headers.get_all("Origin")):
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSAL)
        return None if process_request is None else process_request(connection, request)

    return checked


def has_token(token: str, path: str, cookies: list[str]) -> bool:
    """Whether a request has the token: in its address, or in a cookie of an earlier one."""
    given = parse_qs(urlsplit(path).query).get("token", [])
    for text in cookies:
        try:
            given += [morsel.value for name, morsel in SimpleCookie(text).items() if name == COOKIE]
        except CookieError:
            continue
    return any(hmac.compare_digest(each.strip().encode(), token.encode()) for each in given)


def _with_token(token: str, process_request: Callable[..., Any] | None) -> Callable[..., Any]:
    """Ask everybody for a token, before pages and before websockets; also where Origin differs."""

    def checked(connection: "ServerConnection", request: "Request") -> "Response | Any":
        headers = request.headers
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or origins not in ([], [f"http://{hosts[0]}"]):
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSAL)
        if not has_token(token, request.path, headers.get_all("Cookie")):
            return _page(connection, HTTPStatus.UNAUTHORIZED, ASKING)
        if "token=" in urlsplit(request.path).query:  # from now on the cookie has it
            response = _page(connection, HTTPStatus.SEE_OTHER, "")
            response.headers["Location"] = "/"
            cookie = f"{COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/"
            response.headers["Set-Cookie"] = cookie
            return response
        return None if process_request is None else process_request(connection, request)

    return checked


def _page(connection: "ServerConnection", status: HTTPStatus, text: str) -> "Response":
    response = connection.respond(status, text)
    del response.headers["Content-Type"]
    response.headers["Content-Type"] = "text/html; charset=utf-8"
    return response
