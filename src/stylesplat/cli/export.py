"""`stylesplat export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from stylesplat.cli.options import Json, Overwrite


@dataclass(frozen=True)
class Export:
    """Write a scene's splat for other programs.

    Example: stylesplat export garden-wave garden.spz
    """

    scene: Positional[Path]
    """Folder of the scene."""
    file: Positional[Path]
    """File to make: .ply keeps every bit; .compressed.ply, .spz and .splat are smaller."""
    sh_degree: Literal[0, 1, 2, 3] | None = None
    """Leave out how colours change with the view, above this degree; 0 keeps one colour each."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.places import refuse_file
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.export import export

        refuse_file(self.file, overwrite=self.overwrite)
        scene = open(self.scene)
        export(scene, self.file, overwrite=self.overwrite, sh_degree=self.sh_degree)
        return {"file": self.file, "gaussians": len(scene.splats)}
