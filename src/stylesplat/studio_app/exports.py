"""Files that take long to make: exports and turntables."""

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from stylesplat.errors import StyleSplatError
from stylesplat.figures.web_page import SUFFIX
from stylesplat.io.splats.splat_files import COMPRESSED
from stylesplat.studio_app.messages import Progress
from stylesplat.studio_app.session import Session, Stopped

FORMATS = (".ply", COMPRESSED, ".spz", ".splat", ".sog", ".glb", SUFFIX)

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
