"""`stylesplat render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from tyro.conf import Positional

from stylesplat.cli.options import Device, Json, Output, Overwrite


@dataclass(frozen=True)
class Render:
    """Render a scene into a folder of PNGs, or into a video.

    Example: stylesplat render garden-wave -o orbit.mp4 --views orbit
    """

    first: ClassVar = ("views", "what")
    scene: Positional[Path]
    """Folder of the scene."""
    output: Output
    """Folder of pictures to make, or a file that ends in .mp4."""
    views: Literal["test", "train", "all", "orbit"] = "all"
    """Held-out views, training views, all of them, or a round trip."""
    what: str = "color"
    """color, labels (id maps), identities, depth, or object:NAME."""
    downscale: float = 1.0
    """How many times smaller than the photos."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.drawing.pictures import label_colors
        from stylesplat.io.scene_folder import open
        from stylesplat.io.view_files import is_video, refuse_taken, write_views
        from stylesplat.verbs.render import render

        refuse_taken(self.output, overwrite=self.overwrite)
        views = render(
            open(self.scene),
            self.views,
            what=self.what,
            downscale=self.downscale,
            device=self.device,
        )
        pictures = views.pictures
        if self.what == "labels" and is_video(self.output):
            pictures = map(label_colors, pictures)
        write_views(views.names, pictures, self.output, overwrite=self.overwrite)
        return {"output": self.output, "views": len(views)}
