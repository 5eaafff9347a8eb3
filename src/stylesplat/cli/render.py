"""`stylesplat render`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from stylesplat.cli.next_steps import next_lines, pasted, unused
from stylesplat.cli.options import Device, Json, Output, Overwrite, Verbose


@dataclass(frozen=True)
class Render:
    """Render a scene into a folder of PNGs, or into a video.

    Example: stylesplat render garden-wave -o orbit.mp4 --views orbit
    """

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
    verbose: Verbose = False
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

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        yield f"{self.output}: {result['views']} views."
        yield from next_lines(pasted("export", self.scene, unused(self.scene, ".ply")))
