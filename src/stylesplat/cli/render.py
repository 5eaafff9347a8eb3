"""`stylesplat render`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction

from stylesplat.cli.options import Device, Json, Output, Overwrite, Verbose
from stylesplat.cli.parse import parse_size
from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    from stylesplat.scene.cameras import Cameras
    from stylesplat.scene.scene import Scene
    from stylesplat.verbs.render import Views

MOST_RATE = 1000  # frames a second, and seconds


@dataclass(frozen=True)
class Render:
    """Render a scene into a folder of PNGs, into a video, or into one picture.

    Example: stylesplat render garden-wave -o orbit.mp4 --views orbit
    """

    first: ClassVar = ("views", "path", "what")
    scene: Positional[Path]
    """Folder of the scene."""
    output: Output
    """Folder of pictures to make; a video (.mp4, .mov, .mkv, .webm, .gif, .webp); or one .png,
    .jpg or .webp."""
    views: Literal["test", "train", "all", "orbit"] = "all"
    """Held-out views, training views, all of them, or a round trip."""
    view: UseAppendAction[tuple[str, ...]] = ()
    """This view alone, by the photo's name. May be repeated."""
    around: str | None = None
    """A round trip about this object, which fills the pictures."""
    path: Path | None = None
    """A camera path: a JSON file of nerfstudio's, or of key frames."""
    what: str = "color"
    """color, object:NAME, labels (id maps), label-colors, identities, depth (colours),
    depth-float (TIFF in world units) or depth-16bit (PNG, its scale in depth.json)."""
    background: str | None = None
    """transparent, black, white or #rrggbb; by default black behind color, white behind others."""
    downscale: float = 1.0
    """How many times smaller than the photos."""
    size: str | None = None
    """WIDTHxHEIGHT of a round trip or a path; other shapes show more at two sides."""
    seconds: float | None = None
    """How long a round trip or a path of key frames takes; by default 6, or as the path says."""
    fps: float | None = None
    """Frames a second of a video; by default 30, 14 of a GIF, or what the path says."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.view_files import refuse_taken, write_views

        refuse_taken(self.output, overwrite=self.overwrite)
        views, fps = self._views()
        write_views(
            views.names,
            views.pictures,
            self.output,
            overwrite=self.overwrite,
            scale=views.scale,
            fps=fps,
        )
        scale = {} if views.scale is None else {"world_units_per_step": views.scale}
        return {"output": self.output, "views": len(views), **scale}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        from stylesplat.scene.one_line import counted

        yield f"{self.output}: {counted(result['views'], 'view')}."

    def _views(self) -> "tuple[Views, float | None]":
        """What to draw, and its speed; what else the scene holds, such as colours before, goes."""
        from stylesplat.io.scene_folder import open
        from stylesplat.io.view_files import is_video
        from stylesplat.verbs.render import render

        cameras, fps = self._cameras(scene := open(self.scene))
        as_colors = self.what == "labels" and is_video(self.output, len(cameras))
        views = render(
            scene,
            cameras,
            what="label-colors" if as_colors else self.what,
            background=self.background,
            downscale=self.downscale,
            device=self.device,
        )
        return views, fps

    def _cameras(self, scene: "Scene") -> "tuple[Cameras, float | None]":
        """What to render from, and how many frames a second were asked for."""
        from stylesplat.io.camera_paths import read_camera_path
        from stylesplat.io.view_files import is_video
        from stylesplat.verbs.orbit import orbit
        from stylesplat.verbs.render import cameras_of

        self._refuse_mixed()
        size = None if self.size is None else parse_size(self.size)
        if self.path is not None:
            rates = {"fps": self.fps, "seconds": self.seconds}
            path = read_camera_path(self.path, scene.cameras, **rates)
            cameras = path.cameras if size is None else path.cameras.resize(*size)
            return cameras, path.fps if is_video(self.output, len(cameras)) else self.fps
        if self.around is not None or self.views == "orbit":
            count = self._frames()
            return orbit(scene, around=self.around, frames=count, size=size), self.fps
        if size is not None or self.seconds is not None:
            raise StyleSplatError(
                "--size and --seconds are for a round trip or a path; photos' views are as the "
                "photos. Use --downscale, or --views orbit."
            )
        return cameras_of(scene, self.view or self.views), self.fps

    def _frames(self) -> int | None:
        """Of a round trip. A GIF plays half as many a second, and has half as many."""
        from stylesplat.io.video import GIF_FPS as GIF_FPS
        from stylesplat.io.view_files import is_gif
        from stylesplat.scene.framing import frame_count
        from stylesplat.studio_app.autosave import FRAMES
        from stylesplat.verbs.orbit import FPS

        gif = is_gif(self.output)
        if self.seconds is None and self.fps is None:
            return FRAMES // 2 if gif else FRAMES
        fps = self.fps or (GIF_FPS if gif else FPS)
        return frame_count(FRAMES / FPS if self.seconds is None else self.seconds, fps)

    def _refuse_mixed(self) -> None:
        """Refuse more than one kind of views."""
        if self.view and self.views != "all":
            raise StyleSplatError("--view chooses views by name. Leave --views out.")
        trip = "--around" if self.around is not None else "--path"
        alone = self.around is None and self.path is None
        allowed = ("all", "orbit") if self.path is None else ("all",)
        if not alone and (self.view or self.views not in allowed):
            raise StyleSplatError(f"{trip} says which views there are. Leave the others out.")
        if self.around is not None and self.path is not None:
            raise StyleSplatError("--around and --path are two ways. Choose one.")
        for name, value in (("--fps", self.fps), ("--seconds", self.seconds)):
            if value is not None and not 0 < value <= MOST_RATE:
                raise StyleSplatError(
                    f"Cannot render with {name} {value:g}. Choose between 0 and {MOST_RATE}."
                )
