"""viser's page, which stays empty in a browser without WebGL 2, made to say what is missing."""

import gzip
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from websockets.http11 import Response

HEAD = b"<head>"
CHECK = b"""<script>
if (!document.createElement("canvas").getContext("webgl2")) {
  document.documentElement.innerHTML = `<body style="font: 16px system-ui; background: #161618;
    color: #e6e6e8; display: grid; place-content: center; height: 90vh; max-width: 36em;
    margin: auto"><h1>StyleSplat</h1><p>WebGL 2 is missing or turned off. Turn on hardware
    acceleration in the browser's settings, or open this page in another.</p></body>`;
}
</script>"""


def explained(response: "Response") -> "Response":
    """An answer of viser's; if it is a page, one that tells why nothing is drawn."""
    headers = response.headers
    if headers.get("Content-Type", "").startswith("text/html"):
        response.body = _with_check(bytes(response.body), headers.get("Content-Encoding") == "gzip")
        del headers["Content-Length"]
        headers["Content-Length"] = str(len(response.body))
    return response


@lru_cache(maxsize=2)
def _with_check(body: bytes, zipped: bool) -> bytes:
    page = (gzip.decompress(body) if zipped else body).replace(HEAD, HEAD + CHECK, 1)
    return gzip.compress(page) if zipped else page
