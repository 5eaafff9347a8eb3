"""The panel Keep: saving, exporting, pictures, and the command that does the same."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from stylesplat.errors import StyleSplatError
from stylesplat.figures.browser import camera_of
from stylesplat.studio_app.commands import Held, commands, held_by
from stylesplat.studio_app.keeping import FORMATS, FRAMES, Place, exported, still, turntable
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.studio_state import State
from stylesplat.studio_app.viewing import Stage
from stylesplat.studio_app.widgets import icon

if TYPE_CHECKING:
    import viser

WIDTH = 1920  # pixels of a still picture, at first


class KeepPanel:
    """What becomes of the scene."""

    def __init__(
        self, server: "viser.ViserServer", session: Session, stage: Stage, place: Place
    ) -> None:
        """Add it to the container that is open."""
        self.session, self._stage, self._place, gui = session, stage, place, server.gui
        self._held = {place.folder: held_by(session.saved)}
        self._told = gui.add_markdown("")
        save = gui.add_button("Save", icon=icon("device-floppy"), hint="Into the scene's folder")
        save.on_click(lambda _: session.ask(lambda: place.save(session)))
        name = gui.add_text("Name", f"{place.folder.resolve().name}-painted")
        save_as = gui.add_button("Save as", icon=icon("copy"), hint="A folder beside the scene's")
        save_as.on_click(lambda _: session.ask(lambda: place.save_as(session, name.value)))
        with gui.add_folder("Export"):
            self._files(gui)
        with gui.add_folder("Pictures"):
            self._pictures(gui)
        with gui.add_folder("The same on the command line"):
            self._command = gui.add_markdown("")
        self.refresh()

    def refresh(self) -> None:
        """The state is another."""
        folder = self._place.folder
        word = "Not saved yet" if self.session.unsaved else "All is saved"
        self._told.content = f"{word}. Folder: `{folder}`"
        self._held[folder] = held_by(self.session.saved)
        self._command.content = f"```\n{recounted(self.session.state, folder, self._held)}\n```"

    def _files(self, gui: "viser.GuiApi") -> None:
        ending = gui.add_dropdown("Format", FORMATS)
        button = gui.add_button("Download", icon=icon("download"))

        @button.on_click
        def _(event: "viser.GuiEvent") -> None:
            client, wanted = event.client, ending.value

            def send() -> None:
                content = exported(self.session.state.scene, wanted)
                self._send(client, f"{self._place.folder.resolve().name}{wanted}", content)

            self.session.ask(send)

    def _pictures(self, gui: "viser.GuiApi") -> None:
        width = gui.add_number("Width", WIDTH, min=64, max=8192, step=1)
        button = gui.add_button("This view as PNG", icon=icon("camera"))
        video = gui.add_button("Turntable as MP4", icon=icon("video"))

        @button.on_click
        def _(event: "viser.GuiEvent") -> None:
            client = event.client
            if client is None:
                return

            def send() -> None:
                camera = camera_of(client, pixels=10**9)
                content = still(self.session, camera, int(width.value), self._stage.behind)
                self._send(client, "view.png", content)

            self.session.ask(send)

        @video.on_click
        def _(event: "viser.GuiEvent") -> None:
            self.session.ask(lambda: self._turn(event.client))

    def _turn(self, client: "viser.ClientHandle | None") -> None:
        session = self.session
        if session.painting:
            raise StyleSplatError("Something is being painted. Wait until it is done.")

        def steps() -> Iterator[None]:
            done = list[bytes]()
            try:
                yield from turntable(session, self._stage.behind, done, FRAMES)
            finally:
                session.painting, session.progress = False, None
                session.tell_change()
            self._send(client, "turntable.mp4", done[0])

        session.painting = True
        session.worker.go_on_with(steps())
        session.tell_change()

    def _send(self, client: "viser.ClientHandle | None", name: str, content: bytes) -> None:
        if client is not None:
            client.send_file_download(name, content, save_immediately=True)
            self.session.tell(f"{name}: {len(content) / 1e6:.1f} MB.")


def recounted(state: State, folder: Path, held: Mapping[Path, Held]) -> str:
    """The commands that give a state, from a folder that they can be run from.

    Args:
        state: Of the studio.
        folder: Where Save writes: they start there if they can.
        held: What the folders hold that there are, in the order in which they came about.
    """
    said = list[str]()
    for start in (folder, *(other for other in held if other != folder)):
        output = start.resolve().with_name(f"{start.resolve().name}-painted")
        lines = commands(state, start, output, held[start])
        if lines:
            return "\n".join([*said, *map(broken, lines)])
        if start == folder:
            fact = "holds all of this" if lines is not None else "holds more than this"
            said.append(f"# {folder} {fact}")
    lines = commands(state, folder, folder.with_name(f"{folder.name}-painted")) or []
    said += ["# and came about like this", *map(broken, lines)] if lines else []
    return "\n".join(said)


def broken(command: str) -> str:
    """A command over several lines; as it is where something in it is quoted."""
    return command if "'" in command else command.replace(" -", " \\\n  -")
