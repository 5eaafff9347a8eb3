"""`stylesplat render`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction

from stylesplat.cli.options import Device, Json, Output, Overwrite, Verbose
from stylesplat.errors import StyleSplatError


@dataclass(frozen=True)
class Render:
    """Render a scene into a folder of PNGs, into a video, or into one picture.

    Example: stylesplat render garden-wave -o orbit.mp4 --views orbit
    """

    first: ClassVar = ("views", "what")
    scene: Positional[Path]
    """Folder of the scene."""
    output: Output
    """Folder of pictures to make; a video (.mp4, .mov, .mkv, .webm, .gif); or one .png or .jpg."""
    views: Literal["test", "train", "all", "orbit"] = "all"
    """Held-out views, training views, all of them, or a round trip."""
    view: UseAppendAction[tuple[str, ...]] = ()
    """This view alone, by the photo's name. May be repeated."""
    what: str = "color"
    """color, object:NAME, labels (id maps), label-colors, identities, depth (colours),
    depth-float (TIFF in world units) or depth-16bit (PNG, its scale in depth.json)."""
    background: str | None = None
    """transparent, black, white or #rrggbb; by default black behind color, white behind others."""
    downscale: float = 1.0
    """How many times smaller than the photos."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.scene_folder import open
        from stylesplat.io.view_files import is_gif, is_video, refuse_taken, write_views
        from stylesplat.verbs.render import ORBIT_FRAMES, render

        refuse_taken(self.output, overwrite=self.overwrite)
        if self.view and self.views != "all":
            raise StyleSplatError("--view chooses views by name. Leave --views out.")
        as_colors = self.what == "labels" and is_video(self.output)
        views = render(
            open(self.scene),
            self.view or self.views,
            what="label-colors" if as_colors else self.what,
            background=self.background,
            downscale=self.downscale,
            # A GIF plays half as many a second
            frames=ORBIT_FRAMES // 2 if is_gif(self.output) else None,
            device=self.device,
        )
        write_views(
            views.names, views.pictures, self.output, overwrite=self.overwrite, scale=views.scale
        )
        scale = {} if views.scale is None else {"world_units_per_step": views.scale}
        return {"output": self.output, "views": len(views), **scale}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        from stylesplat.scene.one_line import counted

        yield f"{self.output}: {counted(result['views'], 'view')}."
