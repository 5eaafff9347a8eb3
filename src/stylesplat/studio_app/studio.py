"""`studio` and `view`: choose, paint and compare in the browser, or only look."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NoReturn

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.interrupts import POLL_SECONDS, Terminated, raise_if_interrupted
from stylesplat.io import scene_folder
from stylesplat.options import check_arguments
from stylesplat.progress import say
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.scene.virtual_cameras import ring_cameras
from stylesplat.studio_app.actions import Actions
from stylesplat.studio_app.files import SceneStore
from stylesplat.studio_app.gallery import KEPT_STYLES, Gallery
from stylesplat.studio_app.guard import LOOPBACK, SERVER_ADDRESS
from stylesplat.studio_app.history_files import HistoryFolder
from stylesplat.studio_app.server import PageServer
from stylesplat.studio_app.session import Session

HISTORY_SECONDS = 0.5  # between two looks for what the disk does not have yet


class StudioServer:
    """A running studio, or without a store a viewer."""

    def __init__(
        self, server: PageServer, store: SceneStore | None = None, kept: HistoryFolder | None = None
    ) -> None:
        self.server, self.store, self.kept, self.session = server, store, kept, server.session
        self.url = server.url
        """The address that opens it, with the token."""
        self._has_warned = False
        if kept is not None:
            threading.Thread(target=self._keep, args=(kept,), daemon=True).start()

    def close(self) -> None:
        """End it. What is not saved is in the history, for the next time."""
        if self.session.stopping.is_set():
            return
        self.session.stopping.set()
        self.session.worker.close()
        try:
            with ExitStack() as rest:  # runs all callbacks, the last one first, whatever fails
                rest.callback(self.server.actions.gallery.close)
                rest.callback(self.server.actions.variants.close)
                rest.callback(self.server.stop)
                rest.callback(self._write)
                self.session.interrupt()  # which keeps the result of a painting so far
        except Exception as error:
            say(f"Closing the studio failed, and something may be lost: {error!r}")
            raise

    def _keep(self, kept: HistoryFolder) -> None:
        while not self.session.stopping.wait(HISTORY_SECONDS):
            if kept.is_behind:
                self.session.ask(self._write, kind="history")

    def _write(self) -> None:
        """Write the history in the worker's thread, or as the last thing."""
        is_over, folder = self.session.stopping.is_set(), self.session.folder
        if self.kept is None:
            return
        try:
            if not self.kept.write() and is_over:
                say(f"Not saved, but kept with {folder}: `stylesplat studio` goes on with it.")
        except StyleSplatError as error:
            if not self._has_warned or is_over:
                self._has_warned = True
                say(f"Cannot keep the history: {error}")


@check_arguments
def studio(
    scene: Scene | Path | str,
    *,
    styles: Path | str | None = None,
    port: int = 8080,
    host: str = SERVER_ADDRESS,
    block: bool = True,
    **options: Any,
) -> StudioServer:
    """Choose objects, paint them and compare in a browser.

    Args:
        scene: A scene's folder, or a scene that was opened from one: there it is saved.
        styles: A folder of style pictures; more can be sent from the browser.
        port: Port, or the next free one.
        host: The address to serve at. Others than 127.0.0.1 are open to the network.
        block: Serve until Ctrl-C; otherwise return at once.
        options: Of `stylize_live`, such as `features` and `device`.

    Returns:
        The studio; `close()` ends it.

    Raises:
        StyleSplatError: If Starlette or uvicorn is not installed, the scene is empty or has no
            folder, or there is no folder of styles.
    """
    if not isinstance(scene, Scene):
        scene = scene_folder.open(scene)
    if scene.path is None:
        raise StyleSplatError("This scene has no folder to save to. Save it first, and open that.")
    _refuse_empty(scene.splats)
    gallery = Gallery(None if styles is None else Path(styles), scene.path / KEPT_STYLES)
    session = Session(scene, folder=scene.path)
    store, kept = SceneStore(session), HistoryFolder(session)
    kept.resume()
    is_local = host in LOOPBACK
    actions = Actions(session, gallery, store, kept, is_local=is_local, **options)
    server = PageServer("StyleSplat studio", actions)
    server.start(host, port)
    opened = StudioServer(server, store, kept)
    if not is_local:
        say(
            f"{host} is open to the network: whoever has this address sees, changes, saves and "
            f"downloads {scene.path}. The connection is not encrypted."
        )
    if block:
        _block(opened.close)
    return opened


@check_arguments
def view(what: Scene | Splats, *, port: int = 8080, block: bool = True) -> StudioServer:
    """Show a scene in a browser.

    Args:
        what: A scene, or splats alone, of which nobody knows what is up.
        port: Port on 127.0.0.1, or the next free one.
        block: Serve until Ctrl-C; otherwise return at once.

    Returns:
        The running server; its `url` opens it, `close()` ends it.

    Raises:
        StyleSplatError: If Starlette or uvicorn is not installed, or there is nothing to show.
    """
    splats = what if isinstance(what, Splats) else what.splats
    _refuse_empty(splats)
    if isinstance(what, Splats):
        up = torch.tensor([0.0, 0.0, 1.0])
        what = Scene(what.detach().to("cpu"), ring_cameras(what.detach().to("cpu"), up))
    session = Session(what, folder=what.path or Path())
    server = PageServer("StyleSplat", Actions(session, Gallery(), None))
    server.start(SERVER_ADDRESS, port)
    opened = StudioServer(server)
    if block:
        _block(opened.close)
    return opened


def until_interrupted(stop: Callable[[], object]) -> NoReturn:
    try:
        while True:
            time.sleep(POLL_SECONDS)
            raise_if_interrupted()
    finally:
        stop()


def _block(stop: Callable[[], object]) -> None:
    try:
        until_interrupted(stop)
    except Terminated:
        raise
    except KeyboardInterrupt:  # how it is closed
        pass


def _refuse_empty(splats: Splats) -> None:
    if not len(splats):
        raise StyleSplatError("These splats are empty, so there is nothing to view.")
