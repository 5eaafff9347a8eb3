"""The page of the studio: its panels, its status line, and messages from browsers."""

import html
from collections.abc import Callable
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Annotated

import msgspec

from stylesplat.studio_app.autosave import SceneStore
from stylesplat.studio_app.compare_panel import ComparePanel
from stylesplat.studio_app.gallery import MOST_BYTES, Gallery, too_large
from stylesplat.studio_app.paint_panel import TITLE, PaintPanel
from stylesplat.studio_app.paint_queue import PaintQueue
from stylesplat.studio_app.pick_panel import PickPanel
from stylesplat.studio_app.save_panel import SavePanel
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.thumbnails import icon
from stylesplat.studio_app.viewport import BACKGROUND, Viewport, photo_pose

if TYPE_CHECKING:
    import viser


MARK = "stylesplat:"  # begins the text of the field
FAR = 1e10  # where viser 1.1 draws splats that are hidden, along each axis
MANY = 200  # instances of a shape: the lines of cameras have fewer
SCRIPT = Path(__file__).with_name("browser_events.js")
# An empty picture runs the script, which HTML that is added later does not
PAGE = """<style>div:has(> div > div > div > input[value^="$MARK"]) { display: none; }</style>
<img alt="" hidden src="data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg'/%3E"
onload="$SCRIPT">"""

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]


class BrowserMessage(msgspec.Struct, frozen=True):
    """The state of a browser, as its script reports it."""

    before: bool = False
    """The key is held that displays the scene before painting."""
    at: tuple[Share, Share] | None = None
    """Where the pointer rests over the scene, in shares of the picture."""
    part: tuple[Share, Share, Share, Share] | None = None
    """The rectangle that was just dragged on a picture: left, top, right, bottom."""
    large: int = 0
    """Bytes of an upload that was just refused."""


def parse_message(text: str) -> BrowserMessage | None:
    """The message in the field; None for any other text."""
    try:
        return msgspec.json.decode(text.removeprefix(MARK), type=BrowserMessage)
    except msgspec.DecodeError:
        return None


def listen_to_browsers(
    server: "viser.ViserServer", receive: "Callable[[viser.ClientHandle, BrowserMessage], None]"
) -> None:
    """Add the script to the page, and call `receive` with its messages, which must not wait."""
    names = {"MARK": MARK, "TITLE": TITLE, "MOST": MOST_BYTES, "FAR": FAR, "MANY": MANY}
    script = html.escape(Template(SCRIPT.read_text(encoding="utf-8")).safe_substitute(names))
    server.gui.add_html(Template(PAGE).substitute(names, SCRIPT=script))
    field = server.gui.add_text("page", f"{MARK}{{}}")

    @field.on_update
    async def _(event: "viser.GuiEvent") -> None:
        message = parse_message(field.value)
        if event.client is not None and message is not None:
            receive(event.client, message)


def add_see_panel(server: "viser.ViserServer", viewport: Viewport) -> None:
    gui, scene = server.gui, viewport.session.state.scene
    home = gui.add_button("Home", icon=icon("home"), hint="To what is picked, or where it began")

    @home.on_click
    def _(event: "viser.GuiEvent") -> None:
        if event.client is not None:
            viewport.home(event.client)

    if len(scene.cameras) > 1:
        row = gui.add_slider(
            "Fly to photo", 1, len(scene.cameras), 1, 1, hint="The view of each photo"
        )

        @row.on_update
        def _(event: "viser.GuiEvent") -> None:
            if event.client is not None:
                viewport.move(event.client, photo_pose(scene, scene.cameras[int(row.value) - 1]))

    frames = gui.add_checkbox("Show cameras", False, hint="Click one to fly there")
    frames.on_update(lambda _: viewport.frames(frames.value))
    red, green, blue = (round(255 * each) for each in BACKGROUND)
    color = gui.add_rgb("Background", (red, green, blue))

    @color.on_update
    def _(event: "viser.GuiEvent") -> None:
        red, green, blue = (each / 255 for each in color.value)
        viewport.set_background((red, green, blue))

    gui.add_markdown(
        "Drag to turn, right drag to move, wheel to come closer. To fly: **W A S D**, **Q** down, "
        "**E** up, arrows turn. At rest the picture is exact: all bands of colour."
    )


BRAND = (232, 138, 30)
SECONDS = 6.0  # for which a message stays
# Always two lines high: else the buttons below would move, and clicks miss them
STATUS = """<div style="height: 2.9em; line-height: 1.45; padding: 0 0.9em; font-size: 0.875em;
overflow: hidden; overflow-wrap: anywhere">{}</div>"""


class Page:
    """Everything that browsers display."""

    def __init__(
        self,
        server: "viser.ViserServer",
        session: Session,
        queue: PaintQueue,
        gallery: Gallery,
        store: SceneStore,
    ) -> None:
        self.server, self.session, self._queue = server, session, queue
        self.viewport = Viewport(server, session)
        gui = server.gui
        gui.configure_theme(
            dark_mode=True,
            show_logo=False,
            show_share_button=False,
            brand_color=BRAND,
            control_width="large",
        )
        gui.main_panel.dock_right()
        self._status = gui.add_html("")
        self._bar = gui.add_progress_bar(0.0)
        self._history = gui.add_button_group("History", ("undo", "redo"))
        self._history.on_click(lambda _: session.step(-1 if self._history.value == "undo" else 1))
        undo = gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl")
        undo.on_trigger(lambda _: session.step(-1))
        redo = gui.add_command("Redo", hotkey="Y", modifier="cmd/ctrl")
        redo.on_trigger(lambda _: session.step(1))
        listen_to_browsers(server, self._receive)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Pick", icon("pointer")):
            self.pick = PickPanel(server, session, self.viewport)
        with tabs.add_tab("Paint", icon("brush")):
            self.paint = PaintPanel(server, session, queue, gallery)
        with tabs.add_tab("Compare", icon("adjustments")):
            self.compare = ComparePanel(server, session, self.viewport)
        with tabs.add_tab("Keep", icon("device-floppy")):
            self.keep = SavePanel(server, session, self.viewport, store)
        with tabs.add_tab("See", icon("eye")):
            add_see_panel(server, self.viewport)
        session.on_change.append(self.refresh)
        session.on_progress.append(self.progress)
        session.on_message.append(self._say)
        server.on_client_connect(self._greet)
        self.refresh()

    def refresh(self) -> None:
        for panel in (self.pick, self.paint, self.compare, self.keep):
            panel.refresh()
        self.progress()

    def progress(self) -> None:
        """Update the status line and the bar."""
        progress, waiting = self.session.progress, self._queue.waiting
        if progress is None:
            text = self.session.state.note + (" · not saved" if self.session.unsaved else "")
        else:
            left = "" if progress.left is None else f", {progress.left:.0f} s left"
            doing = f" ({progress.doing})" if progress.doing and not progress.share else ""
            text = f"{progress.what}{doing}{left}" + (f" · {waiting} waiting" if waiting else "")
        self._bar.value = 100 * progress.share if progress else 0.0
        self._status.content = STATUS.format(html.escape(text))

    def _receive(self, client: "viser.ClientHandle", message: BrowserMessage) -> None:
        self.viewport.hold(client.client_id, message.before)
        self.pick.hover.point(client, message.at)
        if message.part is not None:
            self.paint.part.draw(message.part)
        if message.large:
            notify(client, too_large(message.large), failure=True)

    def _say(self, line: str, failure: bool) -> None:
        for client in self.server.get_clients().values():
            notify(client, line, failure=failure)

    def _greet(self, client: "viser.ClientHandle") -> None:
        for line in self.session.greetings:
            notify(client, line)


def notify(client: "viser.ClientHandle", line: str, *, failure: bool = False) -> None:
    client.add_notification(
        "That did not work" if failure else "StyleSplat",
        line,
        color="red" if failure else None,
        auto_close_seconds=(3 if failure else 1) * SECONDS,
    )
