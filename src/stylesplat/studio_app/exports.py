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
    """Writes one export at a time in a thread of its own, so that the page goes on."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._cancelled = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, scene: Scene, ending: str, deliver: Deliver) -> None:
        """Begin to export a scene; `deliver` gets the file's ending and content."""
        if ending not in FORMATS:
            raise StyleSplatError(f"There is no format {ending}. Use {', '.join(FORMATS)}.")
        if self._thread is not None and self._thread.is_alive():
            raise StyleSplatError("An export is under way. Wait until it is done, or cancel it.")
        self._cancelled.clear()
        self._thread = threading.Thread(
            target=self._run, args=(scene, ending, deliver), daemon=True, name="export"
        )
        self._thread.start()

    def cancel(self) -> None:
        self._cancelled.set()

    def wait(self, seconds: float = 60.0) -> None:
        if self._thread is not None:
            self._thread.join(seconds)

    def _run(self, scene: Scene, ending: str, deliver: Deliver) -> None:
        session = self._session

        def show(progress: Progress | None) -> None:
            session.export = progress
            session.on_progress.call()

        def count(share: float) -> None:
            show(Progress(f"Exporting {ending}", share, export=True))

        try:
            count(0.0)
            with session.listening(self._cancelled.is_set, count):
                content = export_bytes(scene, ending)
            if self._cancelled.is_set():
                raise Stopped
            deliver(ending, content)
        except Stopped:
            session.tell("The export was cancelled.")
        except Exception as error:
            session.report(error)
        finally:
            show(None)


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


def render_turntable(
    session: Session, path: Cameras, width: int, fps: int, background: Color, deliver: Deliver
) -> Iterator[None]:
    """Make a video along a path, frame by frame."""
    display, count = session.display, len(path)
    across, down = path.size
    even = [2 * max(1, round(side / 2)) for side in (width, width * down / across)]
    cameras, frames = path.resize(even[0], even[1]), list[torch.Tensor]()
    for row in range(count):
        frames.append(torch.from_numpy(render_display(display, cameras[row], background)))
        share = (row + 1) / count
        session.progress = Progress(f"Turntable: frame {row + 1} of {count}", share)
        session.on_progress.call()
        yield
    with tempfile.TemporaryDirectory(prefix="stylesplat-studio-") as folder:
        file = Path(folder) / "turntable.mp4"
        write_video(frames, file, fps=fps)
        deliver(".mp4", file.read_bytes())
