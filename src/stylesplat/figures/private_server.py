"""A viser server that answers only those who have its token.

Other accounts of this machine reach its ports as well, and any site can make a browser send
requests to it: under a name of its own that it lets point here (DNS rebinding), and over
websockets. Browsers send neither the cookie with the token.
"""

import errno
import hmac
import secrets
import socket
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from io import StringIO
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from stylesplat.errors import StyleSplatError
from stylesplat.progress import write_lines

if TYPE_CHECKING:
    import viser
    from websockets.asyncio.server import ServerConnection
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response

ADDRESS = "127.0.0.1"  # a splat may show somebody's home: never offer it to the network
REFUSAL = "This server needs a token. Open the address that its terminal shows.\n"
COOKIE = "stylesplat-token"
LARGEST = 4 * 2**20  # bytes of what a page sends at once; files come in parts of half a MB


@dataclass(frozen=True)
class PrivateServer:
    """A viser server, and the address that opens it."""

    server: "viser.ViserServer"
    url: str
    """With the token: without it every request is refused."""

    def stop(self) -> None:
        """End it."""
        self.server.stop()


def private_server(port: int, label: str, *, host: str = ADDRESS) -> PrivateServer:
    """Serve to those who have a token, and print the address with it on stderr.

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

    _refuse_address(host, port)
    serve, guarded, token = library.serve, list[bool](), secrets.token_urlsafe(24)

    def serve_guarded(*args: Any, process_request: Any = None, **options: Any) -> Any:
        guarded.append(True)
        options["max_size"] = LARGEST
        return serve(*args, process_request=_with_token(token, process_request), **options)

    library.serve = serve_guarded  # viser has no hook; it has called this when it is made
    try:
        with redirect_stdout(StringIO()):  # viser prints the address without the token
            server = viser.ViserServer(host=host, port=port, label=label)
    finally:
        library.serve = serve
    if not guarded:
        server.stop()
        raise StyleSplatError(
            f"viser {viser.__version__} answers everybody. Run `pip install viser==1.1.1`."
        )
    url = f"http://{host}:{server.get_port()}/?token={token}"
    write_lines(f"{label}: {url}")
    return PrivateServer(server, url)


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


def _has_token(token: str, path: str, headers: "Headers", cookie: str) -> bool:
    """Whether a request has the token: in its address, or in a cookie of an earlier one."""
    given = parse_qs(urlsplit(path).query).get("token", [])
    for text in headers.get_all("Cookie"):
        try:
            given += [morsel.value for name, morsel in SimpleCookie(text).items() if name == cookie]
        except CookieError:
            continue
    return any(hmac.compare_digest(each.encode(), token.encode()) for each in given)


def _with_token(token: str, process_request: Callable[..., Any] | None) -> Callable[..., Any]:
    """Refuse pages, files and websockets without the token, and websockets of other sites."""

    def checked(connection: "ServerConnection", request: "Request") -> "Response | Any":
        headers = request.headers
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or origins not in ([], [f"http://{hosts[0]}"]):
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSAL)
        # One for each port: browsers send a machine's cookies to all its servers
        cookie = f"{COOKIE}-{hosts[0].rpartition(':')[2].strip(']')}"
        if not _has_token(token, request.path, headers, cookie):
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSAL)
        response = None if process_request is None else process_request(connection, request)
        if response is not None:
            value = f"{cookie}={token}; HttpOnly; SameSite=Strict; Path=/"
            response.headers["Set-Cookie"] = value
        return response

    return checked
