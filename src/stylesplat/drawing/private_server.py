"""A viser server that only its own pages may talk to.

Any site can make a browser send requests to this machine: under a name of its own that it lets
point here (DNS rebinding), which `Host` then tells; and over websockets, which browsers open to
everywhere, telling the site as `Origin`. Either could read the splat.
"""

import re
from collections.abc import Callable
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

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


def private_server(port: int, label: str) -> "viser.ViserServer":
    """Serve on this machine alone, to pages of this server alone.

    Args:
        port: Port on 127.0.0.1, or the next free one.
        label: Title of the page.

    Raises:
        StyleSplatError: If viser is not installed, or does not let others be refused.
    """
    try:
        import viser
    except ImportError as error:
        raise StyleSplatError(
            "The viewer needs viser, which is not installed. Run `pip install stylesplat[view]`."
        ) from error
    from websockets.asyncio import server as library

    serve, guarded = library.serve, list[bool]()

    def serve_own(*args: Any, process_request: Any = None, **options: Any) -> Any:
        guarded.append(True)
        return serve(*args, process_request=_own_only(process_request), **options)

    library.serve = serve_own  # viser has no hook; it has called this when it is made
    try:
        server = viser.ViserServer(host=ADDRESS, port=port, label=label)
    finally:
        library.serve = serve
    if not guarded:
        server.stop()
        raise StyleSplatError(
            f"viser {viser.__version__} answers to other sites too. Run `pip install viser==1.1.1`."
        )
    return server


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
