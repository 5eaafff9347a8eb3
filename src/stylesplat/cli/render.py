"""`stylesplat render`; `view` and `studio`: pages that are served until Ctrl-C."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, NoReturn

from tyro.conf import UseAppendAction

import stylesplat as ss
from stylesplat.cli.command import Answer, Command, Device, MakingCommand, Output, SceneFolder
from stylesplat.errors import StyleSplatError
from stylesplat.progress import say

MOST_PIXELS = 16_384  # along a picture's side
MOST_RATE = 1000  # frames a second, and seconds


@dataclass(frozen=True)
class Render(MakingCommand):
    """Render a scene into a folder of PNGs, into a video, or into one picture.

    Example: stylesplat render garden-wave -o orbit.mp4 --views orbit
    """

    scene: SceneFolder
    output: Output
    """Folder of pictures to make; a video (.mp4, .mov, .mkv, .webm, .webp); or one .png,
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
    """color, object:NAME, labels (id maps), label-colors, identities, depth (colours) or
    depth-float (TIFF in world units)."""
    background: str | None = None
    """transparent, black, white or #rrggbb; by default black behind color, white behind others."""
    downscale: float = 1.0
    """How many times smaller than the photos."""
    size: str | None = None
    """WIDTHxHEIGHT of a round trip or a path; other shapes show more at two sides."""
    seconds: float | None = None
    """Duration of a round trip or a path of key frames; by default 6, or as the path says."""
    fps: float | None = None
    """Frames a second of a video; by default 30, or what the path says."""
    device: Device = "auto"

    def run(self) -> Answer:
        from stylesplat.errors import count_noun
        from stylesplat.io.renders import is_video, refuse_taken, write_views

        refuse_taken(self.output, overwrite=self.overwrite)
        cameras, fps = self._cameras(scene := ss.open(self.scene))
        as_colors = self.what == "labels" and is_video(self.output, len(cameras))
        views = ss.render(
            scene,
            cameras,
            what="label-colors" if as_colors else self.what,
            background=self.background,
            downscale=self.downscale,
            device=self.device,
        )
        del scene  # the colours before a style, for example, need not stay in memory
        write_views(views.names, views.pictures, self.output, overwrite=self.overwrite, fps=fps)
        values = {"output": self.output, "views": len(views)}
        return Answer(values, [f"{self.output}: {count_noun(len(views), 'view')}."])

    def _cameras(self, scene: "ss.Scene") -> "tuple[ss.Cameras, float | None]":
        """The cameras to render from, and the frames a second that were asked for."""
        from stylesplat.io.renders import is_video
        from stylesplat.scene.virtual_cameras import frame_count
        from stylesplat.verbs.render import FPS, FRAMES, cameras_of_views

        self._refuse_mixed()
        size = None if self.size is None else _parse_size(self.size)
        if self.path is not None:
            rates = {"fps": self.fps, "seconds": self.seconds}
            offset = scene.world_offset
            path = ss.read_camera_path(self.path, scene.cameras, **rates, world_offset=offset)
            cameras = path.cameras if size is None else path.cameras.resize(*size)
            return cameras, path.fps if is_video(self.output, len(cameras)) else self.fps
        if self.around is not None or self.views == "orbit":
            frames = frame_count(self.seconds or FRAMES / FPS, self.fps or FPS)
            return ss.orbit(scene, around=self.around, frames=frames, size=size), self.fps
        if size is not None or self.seconds is not None:
            raise StyleSplatError(
                "--size and --seconds are for a round trip or a path; photos' views are as the "
                "photos. Use --downscale, or --views orbit."
            )
        return cameras_of_views(scene, self.view or self.views), self.fps

    def _refuse_mixed(self) -> None:
        whole_trip = self.around is not None and self.views == "orbit"
        ways = {
            "--views": self.views != "all" and not whole_trip,
            "--view": bool(self.view),
            "--around": self.around is not None,
            "--path": self.path is not None,
        }
        if sum(ways.values()) > 1:
            given = " and ".join(name for name, is_given in ways.items() if is_given)
            raise StyleSplatError(f"{given} each choose the views. Pass one of them only.")
        for name, value in (("--fps", self.fps), ("--seconds", self.seconds)):
            if value is not None and not 0 < value <= MOST_RATE:
                fact = f"Cannot render with {name} {value:g}."
                raise StyleSplatError(f"{fact} Choose between 0 and {MOST_RATE}.")


def _parse_size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    width, height = map(int, found.groups()) if found else (0, 0)
    if not (2 <= width <= MOST_PIXELS and 2 <= height <= MOST_PIXELS):
        raise StyleSplatError(
            f"Expected WIDTHxHEIGHT in pixels, each 2 to {MOST_PIXELS:,}, got {text!r}."
        )
    return width, height


@dataclass(frozen=True)
class ViewCommand(Command):
    """Look at a scene in the browser.

    Example: stylesplat view garden-wave
    """

    scene: SceneFolder
    port: int = 8080
    """Port on 127.0.0.1, or the next free one."""
    after_interruption: ClassVar[str] = "The viewer is closed."
    serves: ClassVar[bool] = True

    def run(self) -> NoReturn:
        from stylesplat.studio_app.studio import until_interrupted

        viewer = ss.view(ss.open(self.scene), port=self.port, block=False)
        say("Ctrl-C closes the viewer.")
        until_interrupted(viewer.close)


@dataclass(frozen=True)
class StudioCommand(Command):
    """Choose objects, paint them and compare, in the browser.

    Example: stylesplat studio garden-scene --styles Paintings
    """

    scene: SceneFolder
    styles: Path | None = None
    """Folder of style pictures; more can be added in the browser."""
    port: int = 8080
    """Port, or the next free one."""
    host: str = "127.0.0.1"
    """Address to serve at; any other than 127.0.0.1 lets the network in."""
    device: Device = "auto"
    after_interruption: ClassVar[str] = "The studio is closed."
    serves: ClassVar[bool] = True

    def run(self) -> NoReturn:
        from stylesplat.studio_app.studio import until_interrupted

        options = {"port": self.port, "host": self.host, "device": self.device}
        studio = ss.studio(self.scene, styles=self.styles, block=False, **options)
        say("Ctrl-C closes the studio; what is not saved is kept.")
        until_interrupted(studio.close)
