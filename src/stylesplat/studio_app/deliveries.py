"""What the page takes away: files of the scene, pictures of a view, videos."""

import io
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.renders import write_video
from stylesplat.scene.content import content_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.virtual_cameras import turned_view
from stylesplat.studio_app import messages as m
from stylesplat.studio_app.files import FORMATS, Exporter
from stylesplat.studio_app.gallery import Files
from stylesplat.studio_app.history import require_objects
from stylesplat.studio_app.pictures import Pictures, render_pixels
from stylesplat.studio_app.reports import vector
from stylesplat.studio_app.views import KeptViews
from stylesplat.verbs.export import export
from stylesplat.verbs.render import orbit, render

STUDIO_MOST_PIXELS = 8192  # along a side of a still picture
PREVIEW_RATE = 20  # places a second of a path that a page flies along
ANY_PIXELS = 10**9  # of a camera: as many as the page has


class Deliveries:
    """Makes what the page that asks downloads."""

    def __init__(self, pictures: Pictures, views: KeptViews, files: Files) -> None:
        self.session, self.pictures, self.views = pictures.session, pictures, views
        self._files = files
        self.exporter = Exporter(self.session)
        self._content = content_of(self.session.state.scene.splats).extent

    def export(self, ending: m.ShortText) -> None:
        if ending not in FORMATS:
            raise StyleSplatError(f"There is no format {ending}. Use {', '.join(FORMATS)}.")
        make = partial(export, self.session.state.scene)
        self.exporter.start(f"Exporting {ending}", make, ending, self._deliver(ending))

    def picture(self, width: Annotated[int, msgspec.Meta(ge=1, le=STUDIO_MOST_PIXELS)]) -> None:
        camera = self.pictures.camera(ANY_PIXELS)
        camera = camera.downscale(camera.size[0] / width).at_most(STUDIO_MOST_PIXELS)
        pixels = render_pixels(self.session.display.visible, camera, self.pictures.background)
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "PNG")
        self._deliver("-view.png")(file.getvalue())

    def turntable(
        self,
        seconds: Annotated[float, msgspec.Meta(gt=0, le=60)] = 4.0,
        fps: Annotated[int, msgspec.Meta(ge=1, le=60)] = 30,
        width: Annotated[int, msgspec.Meta(ge=64, le=3840)] = 960,
        around: m.ShortText = "",
        path: Literal["photos", "circle", "swing", "views"] = "photos",
    ) -> None:
        """Make a video around an object or the scene: where the photos were taken, or of the view
        of the page in a circle, or to and fro; or along the kept views."""
        scene, frames = self.session.state.scene, max(2, round(seconds * fps))
        require_objects(scene, [around] if around else [])
        if path == "photos":
            cameras = orbit(scene, around=around or None, frames=frames)
        elif path == "views":
            cameras = self.views.path(frames, self.pictures.camera(ANY_PIXELS).size)
        else:
            known = self.session.masks.extent(scene, (around,)) if around else self._content
            view = self.pictures.camera(ANY_PIXELS)
            cameras = turned_view(view, known.centre, self.views.up, frames, path)
        across, down = cameras.size
        cameras = cameras.resize(width, max(2, round(width * down / across)))
        behind = "#" + bytes(round(255 * each) for each in self.pictures.background).hex()
        visible = Scene(self.session.display.visible, scene.cameras)

        def make(file: Path) -> None:
            pictures = render(visible, cameras, background=behind).pictures
            write_video(pictures, file, fps=fps)

        deliver = self._deliver(f"-{'path' if path == 'views' else 'turntable'}.mp4")
        self.exporter.start("Video", make, ".mp4", deliver, renders=True)

    def preview_path(self, seconds: Annotated[float, msgspec.Meta(gt=0, le=60)] = 4.0) -> None:
        """Let the page fly along the kept views."""
        cameras = self.views.path(
            max(2, round(seconds * PREVIEW_RATE)), self.pictures.camera().size
        )
        ahead = cameras.viewmats[:, 2, :3] * self._content.size.norm() / 2
        places = zip(cameras.positions, cameras.positions + ahead, strict=True)
        flight = m.Flight(seconds, [(vector(eye), vector(target)) for eye, target in places])
        self.session.on_send.call(self.pictures.client, "flight", flight)

    def _deliver(self, ending: str) -> Callable[[bytes], None]:
        """The function that lets the present page download a file."""
        session, client = self.session, self.pictures.client
        name = session.folder.resolve().name + ending

        def deliver(content: bytes) -> None:
            url = self._files.add(content, name)
            session.on_send.call(client, ("download", url), m.Download(url, name))
            session.tell(f"{name}: {len(content) / 1e6:.1f} MB")

        return deliver
