"""Who may ask the server of the studio: the addresses that it answers at, and its token.

Other accounts of this machine reach its ports as well, and any site can make a browser send
requests to it: under a name of its own that it lets point here (DNS rebinding), and over
websockets. Browsers send neither the cookie with the token. A name under which somebody opened
the address with the token is that of a server in front of this one.

The token changes with each start. While no studio runs, another account may listen at its port,
and a page that tries to connect again sends the cookie there: a token that outlives the studio
would be in wrong hands. A page goes on as soon as the new address was opened in its browser.
"""

import hmac
import re
import socket
from contextlib import suppress
from ipaddress import ip_address
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from starlette.requests import HTTPConnection
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

SERVER_ADDRESS = "127.0.0.1"  # a splat may show somebody's home: never offer it to the network
LOOPBACK = (SERVER_ADDRESS, "localhost", "::1")
EVERYWHERE = {"0.0.0.0": "192.0.2.1", "::": "2001:db8::1"}  # and an address that no machine has
HOST_HEADER = re.compile(r"([a-z0-9.-]+|\[[0-9a-f:.]+\])(?::([0-9]{1,5}))?", re.IGNORECASE)
NO_TOKEN = "This server needs a token. Open the address that its terminal shows.\n"
NOT_OURS = (
    "This server answers its own pages alone, at its machine's names, and at another name once "
    "its address was opened there with the token. Open the address that its terminal shows.\n"
)
ICON = '<!doctype html><title>Studio</title><link rel="icon" href="/page/icon.svg">'
COOKIE = "stylesplat-token"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self'"
    "; connect-src 'self' ws://{0} wss://{0}"
    "; form-action 'none'; frame-ancestors 'none'; base-uri 'none'"
)


class Guard:
    """Refuses everything without the token, and what other sites ask for."""

    def __init__(self, app: "ASGIApp", token: str, host: str) -> None:
        """`host` is the address that the server listens at."""
        self._app, self._token = app, token
        own = socket.gethostname().lower()
        self._names = {*LOOPBACK, host.lower(), own, f"{own}.local"}
        if host not in LOOPBACK:
            self._names.add(socket.getfqdn().lower())

    async def __call__(self, scope: "Scope", receive: "Receive", send: "Send") -> None:
        from starlette.datastructures import MutableHeaders
        from starlette.requests import HTTPConnection
        from starlette.responses import HTMLResponse, PlainTextResponse
        from starlette.websockets import WebSocketClose

        asked = HTTPConnection(scope)
        hosts = asked.headers.getlist("host")
        named = HOST_HEADER.fullmatch(hosts[0]) if len(hosts) == 1 else None
        # One cookie for each port: browsers send a machine's cookies to all its servers
        cookie = f"{COOKIE}-{named[2] or ''}" if named else ""
        in_address = self._is_token(*asked.query_params.getlist("token"))
        is_opened = in_address and scope["type"] == "http" and scope["path"] == "/"
        if is_opened and named is not None:
            self._names.add(named[1].lower())
        is_ours = named is not None and self._is_ours(asked, named)
        has_token = in_address or self._is_token(asked.cookies.get(cookie, ""))
        if named is None or not is_ours or not has_token:
            is_socket, why = scope["type"] == "websocket", NO_TOKEN if is_ours else NOT_OURS
            refuse = WebSocketClose(1008) if is_socket else PlainTextResponse(why, 403)
            await refuse(scope, receive, send)
            return
        is_secure = asked.headers.get("x-forwarded-proto", asked.url.scheme) in ("https", "wss")

        async def with_headers(message: "Message") -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                value = f"{cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                headers.append("set-cookie", value + "; Secure" * is_secure)
                headers["content-security-policy"] = POLICY.format(named[0])
                headers["x-content-type-options"] = "nosniff"
                headers["referrer-policy"] = "no-referrer"
                headers["cache-control"] = "no-cache"
            await send(message)

        app = self._app
        if is_opened:
            # Not a status 303, with which a link on another site would come without the cookie
            app = HTMLResponse(ICON, headers={"refresh": "0; url=/"})
        await app(scope, receive, with_headers)

    def _is_ours(self, asked: "HTTPConnection", named: re.Match[str]) -> bool:
        """Whether the host is a known name, or any address: those cannot be rebound."""
        name, origins = named[1].strip("[]").lower(), asked.headers.getlist("origin")
        known = name in self._names
        with suppress(ValueError):
            known = known or bool(ip_address(name))
        own = [f"{scheme}://{named[0]}" for scheme in ("http", "https")]
        return known and (not origins or (len(origins) == 1 and origins[0] in own))

    def _is_token(self, *given: str) -> bool:
        return any(hmac.compare_digest(each.encode(), self._token.encode()) for each in given)


def reachable_address(host: str) -> str:
    """The address to open: of this machine in its network, if the server listens everywhere."""
    if host in EVERYWHERE:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        host = LOOPBACK[-1] if ":" in host else SERVER_ADDRESS
        with socket.socket(family, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.connect((EVERYWHERE["::" if family == socket.AF_INET6 else "0.0.0.0"], 9))
            host = probe.getsockname()[0]  # nothing is sent
    return f"[{host}]" if ":" in host else host
