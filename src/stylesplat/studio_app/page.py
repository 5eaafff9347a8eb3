"""The page of the studio: its panels, and what is told in all of them."""

import html
from typing import TYPE_CHECKING

from stylesplat.studio_app.compare_panel import ComparePanel
from stylesplat.studio_app.easel import Easel
from stylesplat.studio_app.gallery import Gallery, too_large
from stylesplat.studio_app.keep_panel import KeepPanel
from stylesplat.studio_app.keeping import Place
from stylesplat.studio_app.paint_panel import PaintPanel
from stylesplat.studio_app.pick_panel import PickPanel
from stylesplat.studio_app.see_panel import add_see_panel
from stylesplat.studio_app.session import Progress, Session
from stylesplat.studio_app.viewing import Stage
from stylesplat.studio_app.widgets import icon
from stylesplat.studio_app.wire import Said, add_wire

if TYPE_CHECKING:
    import viser

BRAND = (232, 138, 30)
SECONDS = 6.0  # that a word is shown
UNDO, REDO = "undo", "redo"
# Of two lines however long the word is: else what is below would move, and clicks hit other buttons
STATUS = """<div style="height: 2.9em; line-height: 1.45; padding: 0 0.9em; font-size: 0.875em;
overflow: hidden; overflow-wrap: anywhere">{}</div>"""


class Page:
    """Everything that browsers show."""

    def __init__(
        self,
        server: "viser.ViserServer",
        session: Session,
        easel: Easel,
        gallery: Gallery,
        place: Place,
    ) -> None:
        """Build it."""
        self.server, self.session, self._easel = server, session, easel
        self.stage = Stage(server, session)
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
        self._history = gui.add_button_group("History", (UNDO, REDO))
        self._history.on_click(lambda _: session.step(-1 if self._history.value == UNDO else 1))
        self._keys(gui)
        add_wire(server, self._told)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Pick", icon("pointer")):
            self.pick = PickPanel(server, session, self.stage)
        with tabs.add_tab("Paint", icon("brush")):
            self.paint = PaintPanel(server, session, easel, gallery)
        with tabs.add_tab("Compare", icon("adjustments")):
            self.compare = ComparePanel(server, session, self.stage)
        with tabs.add_tab("Keep", icon("device-floppy")):
            self.keep = KeepPanel(server, session, self.stage, place)
        with tabs.add_tab("See", icon("eye")):
            add_see_panel(server, self.stage)
        session.on_change(self.refresh)
        session.on_progress(self.progress)
        session.on_word(self._say)
        server.on_client_connect(self._greet)
        self.refresh()

    def refresh(self) -> None:
        """The state is another: in the worker's thread."""
        for panel in (self.pick, self.paint, self.compare, self.keep):
            panel.refresh()
        self.progress()

    def progress(self) -> None:
        """How far long work is."""
        progress = self.session.progress
        self._bar.value = 100 * progress.share if progress else 0.0
        self._status.content = STATUS.format(html.escape(self._word(progress)))

    def _word(self, progress: Progress | None) -> str:
        if progress is None:
            star = " · not saved" if self.session.unsaved else ""
            return f"{self.session.state.note}{star}"
        waiting = self._easel.waiting
        left = "" if progress.left is None else f", {progress.left:.0f} s left"
        doing = f" ({progress.doing})" if progress.doing and not progress.share else ""
        queue = f" · {waiting} waiting" if waiting else ""
        return f"{progress.what}{doing}{left}{queue}"

    def _keys(self, gui: "viser.GuiApi") -> None:
        back = gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl")
        back.on_trigger(lambda _: self.session.step(-1))
        forth = gui.add_command("Redo", hotkey="Y", modifier="cmd/ctrl")
        forth.on_trigger(lambda _: self.session.step(1))

    def _told(self, client: "viser.ClientHandle", said: Said) -> None:
        self.stage.hold(client.client_id, said.before)
        self.pick.hover.point(client, said.at)
        if said.part is not None:
            self.paint.part.draw(said.part)
        if said.large:
            notify(client, too_large(said.large), failure=True)

    def _say(self, line: str, failure: bool) -> None:
        for client in self.server.get_clients().values():
            notify(client, line, failure=failure)

    def _greet(self, client: "viser.ClientHandle") -> None:
        for line in self.session.greetings:
            notify(client, line)


def notify(client: "viser.ClientHandle", line: str, *, failure: bool = False) -> None:
    """Show a line in one browser; failures stay longer."""
    client.add_notification(
        "That did not work" if failure else "StyleSplat",
        line,
        color="red" if failure else None,
        auto_close_seconds=(3 if failure else 1) * SECONDS,
    )
