"""`stylesplat export`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from stylesplat.cli.next_steps import next_lines, pasted, size_of, unused
from stylesplat.cli.options import Json, Overwrite, Verbose


@dataclass(frozen=True)
class Export:
    """Write a scene's splat for other programs.

    Example: stylesplat export garden-wave garden.spz
    """

    scene: Positional[Path]
    """Folder of the scene."""
    file: Positional[Path]
    """File to make: .ply keeps every bit, .spz and .splat are smaller."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.export import export

        scene = open(self.scene)
        export(scene, self.file, overwrite=self.overwrite)
        return {"file": self.file, "gaussians": len(scene.splats)}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        count = f"{result['gaussians']:,} Gaussians, {size_of(self.file)}"
        yield f"{self.file}: {count}. SuperSplat, Blender and other programs open it."
        video = unused(self.scene, ".mp4")
        yield from next_lines(pasted("render", self.scene, "-o", video, "--views", "orbit"))
