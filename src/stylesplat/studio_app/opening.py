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
from stylesplat.studio_app.easel import Easel
from stylesplat.studio_app.gallery import MOST_BYTES, Gallery, too_large
from stylesplat.studio_app.keeping import Place
from stylesplat.studio_app.page import Page
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.uploads import bound_uploads
from stylesplat.studio_app.warming import warm_up_for_the_first

AUTOSAVE_SECONDS = 60.0


class Studio:
    """A studio that is open."""

    def __init__(self, opened: PrivateServer, page: Page, place: Place, gallery: Gallery):
        self.server, self.page, self.place, self._gallery = opened.server, page, place, gallery
        self.session = page.session
        self.url = opened.url
        """The address that opens it, with the token."""
        self._closed = threading.Event()
        self._complained = False
        self.session.on_painted(lambda name, title: self.autosave())
        self._timer = threading.Thread(target=self._autosaves, daemon=True)
        self._timer.start()

    def wait(self) -> None:
        """Serve until Ctrl-C, then close."""
        try:
            while not self._closed.wait(1.0):
                pass
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self) -> None:
        """End it; what is not saved is kept in the scene's folder for the next time."""
        if self._closed.is_set():
            return
        self._closed.set()
        self.session.worker.close()
        try:
            with ExitStack() as rest:  # all of it is done, the last line first, whatever fails
                rest.callback(self._gallery.close)
                rest.callback(self.session.close)
                rest.callback(self.server.stop)
                rest.callback(self._keep_at_the_end)
                self.session.interrupt()  # what there is of a painting is kept, too
        except Exception as error:
            say(f"Closing the studio failed, and something may be lost: {error!r}")
            raise

    def _keep_at_the_end(self) -> None:
        if self._keep():
            say(
                f"Kept what was not saved in {self.place.folder}: `stylesplat studio` goes on "
                "with it."
            )

    def _autosaves(self) -> None:
        while not self._closed.wait(AUTOSAVE_SECONDS):
            self.session.ask(self.autosave, kind="autosave", patient=True)

    def autosave(self) -> None:
        """In the worker's thread: keep what is not saved, unless something is painted now.

        What is painted is kept as soon as it is done.
        """
        if not self.session.painting:
            self._keep()

    def _keep(self) -> bool:
        try:
            return self.place.autosave(self.session)
        except StyleSplatError as error:
            if not self._complained or self._closed.is_set():
                self._complained = True  # once is enough
                say(f"Nothing is kept against crashes: {error}")
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
) -> Studio:
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
    place = Place(scene.path)
    _recover(session, place)
    page = Page(server, session, Easel(session, **options), gallery, place)
    bound_uploads(server, MOST_BYTES, lambda size: session.tell(too_large(size), failure=True))
    warm_up_for_the_first(server, session.worker, **options)
    opened = Studio(private, page, place, gallery)
    if host != ADDRESS:
        say(f"{host} is open to the network: who has the token sees and changes the scene.")
    if block:
        opened.wait()
    return opened


def _recover(session: Session, place: Place) -> None:
    """Go on with what an earlier run left unsaved."""
    try:
        kept = place.recovered(session.state)
    except StyleSplatError as error:
        say(f"Nothing of the last time is recovered. {error}")
        return
    if kept is not None:
        session.history.add(kept)
        say("Recovered what was not saved the last time. Undo goes back to what was saved.")
