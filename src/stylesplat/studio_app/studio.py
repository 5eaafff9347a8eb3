"""`studio`: choose, paint and compare in the browser."""

import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError
from stylesplat.figures.browser import refuse_empty
from stylesplat.figures.private_server import ADDRESS, PrivateServer, private_server
from stylesplat.io import scene_folder
from stylesplat.progress import say
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.autosave import SceneStore
from stylesplat.studio_app.gallery import MOST_BYTES, Gallery, limit_uploads, too_large
from stylesplat.studio_app.page import Page
from stylesplat.studio_app.paint_queue import PaintQueue, warm_up_at_first_client
from stylesplat.studio_app.session import Session

AUTOSAVE_SECONDS = 60.0


class StudioServer:
    """A running studio."""

    def __init__(self, opened: PrivateServer, page: Page, store: SceneStore, gallery: Gallery):
        self.server, self.page, self.store, self._gallery = opened.server, page, store, gallery
        self.session = page.session
        self.url = opened.url
        """The address that opens it, with the token."""
        self._closed = threading.Event()
        self._has_warned = False
        self.session.on_painted.append(lambda name, title: self.autosave())
        self._timer = threading.Thread(target=self._autosaves, daemon=True)
        self._timer.start()

    def wait(self) -> None:
        try:
            while not self._closed.wait(1.0):
                pass
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self) -> None:
        """Close the studio. An unsaved scene is autosaved for the next time."""
        if self._closed.is_set():
            return
        self._closed.set()
        self.session.worker.close()
        try:
            with ExitStack() as rest:  # runs all callbacks, the last one first, whatever fails
                rest.callback(self._gallery.close)
                rest.callback(self.session.close)
                rest.callback(self.server.stop)
                rest.callback(self._autosave_at_the_end)
                self.session.interrupt()  # which keeps the result of a painting so far
        except Exception as error:
            say(f"Closing the studio failed, and something may be lost: {error!r}")
            raise

    def _autosave_at_the_end(self) -> None:
        if self._autosave():
            say(f"Autosaved {self.store.folder}: `stylesplat studio` recovers what is not saved.")

    def _autosaves(self) -> None:
        while not self._closed.wait(AUTOSAVE_SECONDS):
            self.session.ask(self.autosave, kind="autosave", patient=True)

    def autosave(self) -> None:
        """Autosave in the worker's thread, unless an object is being painted."""
        if not self.session.painting:
            self._autosave()

    def _autosave(self) -> bool:
        try:
            return self.store.autosave(self.session)
        except StyleSplatError as error:
            if not self._has_warned or self._closed.is_set():
                self._has_warned = True
                say(f"Cannot autosave the scene: {error}")
            return False


@check_arguments
def studio(
    scene: Scene | Path | str,
    *,
    styles: Path | str | None = None,
    port: int = 8080,
    host: str = ADDRESS,
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
        StyleSplatError: If viser is not installed, the scene is empty or has no folder, or there
            is no folder of styles.
    """
    if not isinstance(scene, Scene):
        scene = scene_folder.open(scene)
    if scene.path is None:
        raise StyleSplatError("This scene has no folder to save to. Save it first, and open that.")
    refuse_empty(scene.splats)
    gallery = Gallery(None if styles is None else Path(styles))
    private = private_server(port, "StyleSplat studio", host=host)
    server = private.server
    session = Session(scene, folder=scene.path)
    store = SceneStore(scene.path)
    _recover(session, store)
    page = Page(server, session, PaintQueue(session, **options), gallery, store)
    limit_uploads(server, MOST_BYTES, lambda size: session.tell(too_large(size), failure=True))
    warm_up_at_first_client(server, session.worker, **options)
    opened = StudioServer(private, page, store, gallery)
    if host != ADDRESS:
        say(f"{host} is open to the network: anybody with the token sees and changes the scene.")
    if block:
        opened.wait()
    return opened


def _recover(session: Session, store: SceneStore) -> None:
    try:
        kept = store.recover(session.state)
    except StyleSplatError as error:
        say(f"Cannot recover the autosave of the last time. {error}")
        return
    if kept is not None:
        session.history.add(kept)
        say("Recovered what was not saved the last time. Undo goes back to the saved scene.")
