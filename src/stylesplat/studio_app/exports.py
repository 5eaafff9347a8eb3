"""Files to take away: exports, pictures and turntables."""

import io
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.figures.web_page import SUFFIX
from stylesplat.io.splats.splat_files import COMPRESSED
from stylesplat.io.video import write_video
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.messages import Look
from stylesplat.studio_app.pictures import Color, camera_of, render_display
from stylesplat.studio_app.session import Progress, Session, Stopped
from stylesplat.verbs.export import export

FORMATS = (".ply", COMPRESSED, ".spz", ".splat", ".sog", ".glb", SUFFIX)
MOST_PIXELS = 8192  # along a side of a still picture

Deliver = Callable[[str, bytes], None]


class Exporter:
    """Makes one file at a time while the page goes on."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._cancelled = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, scene: Scene, ending: str, deliver: Deliver) -> None:
        """Export a scene in a thread of its own; `deliver` gets the file's ending and content."""
        if ending not in FORMATS:
            raise StyleSplatError(f"There is no format {ending}. Use {', '.join(FORMATS)}.")
        what = f"Exporting {ending}"
        self._begin(what)

        def count(share: float) -> None:
            self._show(Progress(what, share, export=True))

        def make() -> bytes:
            with self._session.listening(self._cancelled.is_set, count):
                return export_bytes(scene, ending)

        self._thread = threading.Thread(
            target=self._run, args=(make, ending, deliver), daemon=True, name="export"
        )
        self._thread.start()

    def film(
        self, path: Cameras, width: int, fps: int, background: Color, deliver: Deliver
    ) -> None:
        """Make a video in the worker's thread, which does other jobs between its frames."""
        session = self._session
        self._begin("Turntable")

        def make() -> bytes:
            with tempfile.TemporaryDirectory(prefix="stylesplat-studio-") as folder:
                file = Path(folder) / "turntable.mp4"
                write_video(
                    _frames(session, path, width, background, self._cancelled), file, fps=fps
                )
                return file.read_bytes()

        session.ask(lambda: self._run(make, ".mp4", deliver), patient=True)

    def cancel(self) -> None:
        self._cancelled.set()

    def wait(self, seconds: float = 60.0) -> None:
        if self._thread is not None:
            self._thread.join(seconds)

    def _show(self, progress: Progress | None) -> None:
        self._session.export = progress
        self._session.on_progress.call()

    def _begin(self, what: str) -> None:
        if self._session.export is not None:
            raise StyleSplatError("An export is under way. Wait until it is done, or cancel it.")
        self._cancelled.clear()
        self._show(Progress(what, 0.0, export=True))

    def _run(self, make: Callable[[], bytes], ending: str, deliver: Deliver) -> None:
        try:
            content = make()
            if self._cancelled.is_set():
                raise Stopped
            deliver(ending, content)
        except Stopped:
            self._session.tell("The export was cancelled.")
        except Exception as error:
            self._session.report(error)
        finally:
            self._show(None)


def export_bytes(scene: Scene, ending: str) -> bytes:
    """The content of a file with the scene in another format, or as a web page."""
    with tempfile.TemporaryDirectory(prefix="stylesplat-studio-") as folder:
        path = Path(folder) / f"scene{ending}"
        export(scene, path)
        return path.read_bytes()


def render_png(session: Session, look: Look, width: int, background: Color) -> bytes:
    """A PNG of a view."""
    if not 1 <= width <= MOST_PIXELS:
        raise StyleSplatError(f"A picture has 1 to {MOST_PIXELS} pixels a side, not {width}.")
    camera = camera_of(look, pixels=10**9)
    if width * camera.size[1] > MOST_PIXELS * camera.size[0]:
        raise StyleSplatError(f"The picture would be higher than {MOST_PIXELS} pixels.")
    camera = camera.downscale(float(camera.sizes[0, 0]) / width)
    file = io.BytesIO()
    Image.fromarray(render_display(session.display, camera, background)).save(file, "PNG")
    return file.getvalue()


def _frames(
    session: Session,
    path: Cameras,
    width: int,
    background: Color,
    cancelled: threading.Event,
) -> Iterator[torch.Tensor]:
    """The frames of a video, whose sides are even."""
    display, (across, down), count = session.display, path.size, len(path)
    even = [2 * max(1, round(side / 2)) for side in (width, width * down / across)]
    cameras = path.resize(even[0], even[1])
    for row in range(count):
        session.worker.breathe()
        if cancelled.is_set():
            raise Stopped
        yield torch.from_numpy(render_display(display, cameras[row], background))
        what = f"Turntable: frame {row + 1} of {count}"
        session.export = Progress(what, (row + 1) / count, export=True)
        session.on_progress.call()
