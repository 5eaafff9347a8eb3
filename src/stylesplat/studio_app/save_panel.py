"""The panel Keep: saving, exports, pictures, and the commands that do the same."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.figures.browser import camera_of
from stylesplat.scene.arguments import pasted
from stylesplat.scene.layer import Layer
from stylesplat.studio_app.autosave import (
    FORMATS,
    FRAMES,
    SceneStore,
    export_bytes,
    render_png,
    render_turntable,
)
from stylesplat.studio_app.history import StudioState
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.thumbnails import icon
from stylesplat.studio_app.viewport import Viewport
from stylesplat.stylization.config import StyleConfig, plain_settings

if TYPE_CHECKING:
    import viser


# Settings that are no options of `stylize`
NO_OPTIONS = frozenset({"intensity", "lr", "final_lr", "view_share", "object_size"})


def command_lines(
    state: StudioState, folder: Path, output: Path, held: StudioState | None = None
) -> list[str] | None:
    """The commands that lead to a state from the one that a folder holds, if any do."""
    known, layers = held.commands if held else (), held.scene.layers if held else ()
    new = [
        each for each in state.scene.layers if not any(_is_same(each, other) for other in layers)
    ]
    before = [layer.object for layer in layers]
    added = [layer.object for layer in new if layer.object not in before]
    objects = [layer.object for layer in state.scene.layers]
    if state.commands[: len(known)] != known or [*before, *added] != objects:
        return None
    lines = [_with_folder(words, folder) for words in state.commands[len(known) :]]
    source = folder
    for number, layer in enumerate(new):
        last = number == len(new) - 1
        after = output if last else output.with_name(f"{output.name}-{number + 1}")
        lines.append(pasted("stylize", source, *_options(layer), "-o", after))
        source = after
    return lines


def _is_same(a: Layer, b: Layer) -> bool:
    names = ("object", "styles", "settings", "strength", "form")
    return all(getattr(a, n) == getattr(b, n) for n in names) and torch.equal(a.rows, b.rows)


def _with_folder(words: tuple[str, ...], folder: Path) -> str:
    return pasted(*(str(folder) if word == "SCENE" else word for word in words))


def _options(layer: Layer) -> Iterator[str]:
    pictures = ",".join(str(source.path or "PICTURE") for source in layer.styles)
    yield from ("--style", f"{layer.object}={pictures}")
    usual = plain_settings(StyleConfig())
    for field in fields(StyleConfig):
        value = layer.settings.get(field.name, usual[field.name])
        if field.name in NO_OPTIONS or value == usual[field.name]:
            continue
        option = f"--{field.name.replace('_', '-')}"
        if value is True:
            yield option
        elif isinstance(value, list):
            yield from (option, *map(str, value))
        else:
            yield f"{option}={value}"
    if layer.strength != 1:
        yield f"--intensity={layer.strength:g}"


WIDTH = 1920  # pixels of a still picture, at first


class SavePanel:
    """The controls of files and pictures."""

    def __init__(
        self, server: "viser.ViserServer", session: Session, viewport: Viewport, store: SceneStore
    ) -> None:
        self.session, self._viewport, self._store, gui = session, viewport, store, server.gui
        self._held = {store.folder: session.saved}
        self._status = gui.add_markdown("")
        save = gui.add_button("Save", icon=icon("device-floppy"), hint="Into the scene's folder")
        save.on_click(lambda _: session.ask(lambda: store.save(session)))
        name = gui.add_text("Name", f"{store.folder.resolve().name}-painted")
        save_as = gui.add_button("Save as", icon=icon("copy"), hint="A folder beside the scene's")
        save_as.on_click(lambda _: session.ask(lambda: store.save_as(session, name.value)))
        with gui.add_folder("Export"):
            self._files(gui)
        with gui.add_folder("Pictures"):
            self._pictures(gui)
        with gui.add_folder("The same on the command line"):
            self._command = gui.add_markdown("")
        self.refresh()

    def refresh(self) -> None:
        folder = self._store.folder
        word = "Not saved yet" if self.session.unsaved else "All is saved"
        self._status.content = f"{word}. Folder: `{folder}`"
        self._held[folder] = self.session.saved
        self._command.content = f"```\n{commands_text(self.session.state, folder, self._held)}\n```"

    def _files(self, gui: "viser.GuiApi") -> None:
        ending = gui.add_dropdown("Format", FORMATS)
        button = gui.add_button("Download", icon=icon("download"))

        @button.on_click
        def _(event: "viser.GuiEvent") -> None:
            client, wanted = event.client, ending.value

            def send() -> None:
                content = export_bytes(self.session.state.scene, wanted)
                self._send(client, f"{self._store.folder.resolve().name}{wanted}", content)

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
                content = render_png(
                    self.session, camera, int(width.value), self._viewport.background
                )
                self._send(client, "view.png", content)

            self.session.ask(send)

        @video.on_click
        def _(event: "viser.GuiEvent") -> None:
            self.session.ask(lambda: self._turn(event.client))

    def _turn(self, client: "viser.ClientHandle | None") -> None:
        session = self.session
        if session.painting:
            raise StyleSplatError("An object is being painted. Wait until it is done.")

        def steps() -> Iterator[None]:
            done = list[bytes]()
            try:
                yield from render_turntable(session, self._viewport.background, done, FRAMES)
            finally:
                session.painting, session.progress = False, None
                session.on_change.call()
            self._send(client, "turntable.mp4", done[0])

        session.painting = True
        session.worker.go_on_with(steps())
        session.on_change.call()

    def _send(self, client: "viser.ClientHandle | None", name: str, content: bytes) -> None:
        if client is not None:
            client.send_file_download(name, content, save_immediately=True)
            self.session.tell(f"{name}: {len(content) / 1e6:.1f} MB.")


def commands_text(state: StudioState, folder: Path, held: Mapping[Path, StudioState]) -> str:
    """The commands that give a state, from a folder that holds a part of it."""
    text = list[str]()
    for start in (folder, *(other for other in held if other != folder)):
        output = start.resolve().with_name(f"{start.resolve().name}-painted")
        lines = command_lines(state, start, output, held[start])
        if lines:
            return "\n".join([*text, *map(wrap_command, lines)])
        if start == folder:
            fact = "holds all of this" if lines is not None else "holds more than this"
            text.append(f"# {folder} {fact}")
    lines = command_lines(state, folder, folder.with_name(f"{folder.name}-painted")) or []
    text += ["# and came about like this", *map(wrap_command, lines)] if lines else []
    return "\n".join(text)


def wrap_command(command: str) -> str:
    """A command over several lines, unless it has quotes."""
    return command if "'" in command else command.replace(" -", " \\\n  -")
