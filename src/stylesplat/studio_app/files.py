"""Files of the studio: saved scenes, exports, turntables."""

import threading
from collections.abc import Callable
from contextvars import copy_context
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from stylesplat.errors import StyleSplatError
from stylesplat.figures.web_page import WEB_SUFFIX
from stylesplat.io import scene_folder
from stylesplat.io.atomic import locked_folder, refuse_unwritable
from stylesplat.io.splats.splat_files import COMPRESSED
from stylesplat.studio_app.edits import solo_layer
from stylesplat.studio_app.gallery import NO_NAME
from stylesplat.studio_app.messages import Progress
from stylesplat.studio_app.session import Session, Stopped

Stamp = dict[Path, tuple[int, int]]


class SceneStore:
    """Saves a session's scene into its folder, which other programs may change meanwhile."""

    def __init__(self, session: Session) -> None:
        self._session, self._stamp = session, _stamp(session.folder)

    def save(self) -> None:
        session, folder = self._session, self._session.folder
        self._show_all()
        with locked_folder(folder):
            if _stamp(folder) != self._stamp:
                raise StyleSplatError(
                    f"Another program has changed {folder}. Save the scene under another name."
                )
            refuse_unwritable(folder)
            scene_folder.revise(session.saved.scene, session.state.scene, folder)
        self._finish_save(folder)

    def save_as(self, name: str) -> None:
        """Save the scene into a new folder beside its own, and work on that."""
        if not name.strip() or NO_NAME.search(name):  # it is a name and no path
            raise StyleSplatError(f"No folder can be called {name!r}. Use letters and digits.")
        folder = self._session.folder.resolve().parent / name
        if folder.exists():
            raise StyleSplatError(f"There is a folder {folder} already. Choose another name.")
        self._show_all()
        scene_folder.save(self._session.state.scene, folder)
        self._finish_save(folder)

    def _show_all(self) -> None:
        """End that a layer is shown alone: that is to look at it, and is not saved."""
        state = self._session.state
        if state.solo:
            self._session.history.add(solo_layer(state, state.solo[0]))

    def _finish_save(self, folder: Path) -> None:
        session = self._session
        session.folder, session.saved, self._stamp = folder, session.state, _stamp(folder)
        session.tell(f"Saved {folder}.")
        session.on_change.call()


def _stamp(folder: Path) -> Stamp:
    """Times and sizes of a scene's files, which tell whether the scene has changed."""
    try:
        found = {file: file.stat() for file in scene_folder.content_files(folder)}
    except OSError:
        return {}
    return {file: (each.st_mtime_ns, each.st_size) for file, each in found.items()}


FORMATS = (".ply", COMPRESSED, ".spz", ".splat", ".sog", ".glb", WEB_SUFFIX)

Make = Callable[[Path], object]
Deliver = Callable[[bytes], None]


class Exporter:
    def __init__(self, session: Session) -> None:
        self._session = session
        self._cancelled = threading.Event()

    def start(
        self, what: str, make: Make, ending: str, deliver: Deliver, *, renders: bool = False
    ) -> None:
        """Begin with a file, which `make` writes and whose content `deliver` gets.

        What `renders` is made in the worker's thread, which does other jobs meanwhile; all else in
        a thread of its own.
        """
        if self._session.export is not None:
            raise StyleSplatError("An export is under way. Wait until it is done, or cancel it.")
        self._cancelled.clear()
        self._count(what, 0.0)
        job = partial(self._run, what, make, ending, deliver)
        if renders:
            self._session.ask(job, patient=True)
            return
        job = partial(copy_context().run, job)  # which tells the page that asked for it
        threading.Thread(target=job, daemon=True, name="export").start()

    def cancel(self) -> None:
        self._cancelled.set()

    def _count(self, what: str, share: float) -> None:
        self._session.export = Progress(what, share, export=True) if what else None
        self._session.on_progress.call()

    def _run(self, what: str, make: Make, ending: str, deliver: Deliver) -> None:
        try:
            listening = self._session.listening(self._cancelled.is_set, partial(self._count, what))
            with TemporaryDirectory(prefix="stylesplat-studio-") as folder, listening:
                file = Path(folder) / f"scene{ending}"
                make(file)
                if self._cancelled.is_set():
                    raise Stopped
                deliver(file.read_bytes())
        except Stopped:
            self._session.tell("The export was cancelled.")
        except Exception as error:
            self._session.report(error)
        finally:
            self._count("", 0.0)
