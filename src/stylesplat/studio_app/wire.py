"""What viser's page does not tell by itself: a held key, where the pointer rests, drags.

A small script sees these and writes them into a text field of the page, which viser sends. It also
lets the page not draw splats that are hidden.
"""

import html
from collections.abc import Callable
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Annotated

import msgspec

from stylesplat.studio_app.gallery import MOST_BYTES

if TYPE_CHECKING:
    import viser

MARK = "stylesplat:"  # begins what the field holds
TITLE = "Drag a rectangle for a part of it"  # of the picture that can be dragged on
FAR = 1e10  # where viser 1.1 draws splats that are hidden, along each axis
MANY = 200  # instances of a shape: more than the lines of cameras have
SCRIPT = Path(__file__).with_name("wire.js")
# An empty picture, as scripts in HTML that is added later do not run by themselves
PAGE = """<style>div:has(> div > div > div > input[value^="$MARK"]) { display: none; }</style>
<img alt="" hidden src="data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg'/%3E"
onload="$SCRIPT">"""

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]


class Said(msgspec.Struct, frozen=True):
    """What a browser tells."""

    before: bool = False
    """Whether what was before is to be seen, for as long as this holds."""
    at: tuple[Share, Share] | None = None
    """Where the pointer rests over the scene, in shares of the picture."""
    part: tuple[Share, Share, Share, Share] | None = None
    """What was dragged on a picture just now: left, top, right, bottom."""
    large: int = 0
    """Bytes of a file that was to be sent just now and has too many."""


def read(text: str) -> Said | None:
    """What the field holds; None if that is nothing of the script's."""
    try:
        return msgspec.json.decode(text.removeprefix(MARK), type=Said)
    except msgspec.DecodeError:
        return None


def add_wire(
    server: "viser.ViserServer", told: "Callable[[viser.ClientHandle, Said], None]"
) -> None:
    """Add the script to the page of all browsers.

    Args:
        server: Whose page.
        told: Is called with what a browser tells, in the order of that; must not wait.
    """
    names = {"MARK": MARK, "TITLE": TITLE, "MOST": MOST_BYTES, "FAR": FAR, "MANY": MANY}
    script = html.escape(Template(SCRIPT.read_text(encoding="utf-8")).safe_substitute(names))
    server.gui.add_html(Template(PAGE).substitute(names, SCRIPT=script))
    field = server.gui.add_text("page", f"{MARK}{{}}")

    @field.on_update
    async def _(event: "viser.GuiEvent") -> None:
        said = read(field.value)
        if event.client is not None and said is not None:
            told(event.client, said)
