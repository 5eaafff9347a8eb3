"""`stylesplat export`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from tyro.conf import Positional

from stylesplat.cli.next_steps import next_lines, pasted, size_of, unused
from stylesplat.cli.options import Json, OptionalOutput, Overwrite, Verbose
from stylesplat.errors import StyleSplatError


@dataclass(frozen=True)
class Export:
    """Write a scene's splat for other programs, or as a web page that shows it.

    Example: stylesplat export garden-wave garden.html
    """

    first: ClassVar = ("output",)
    scene: Positional[Path]
    """Folder of the scene."""
    file: Positional[Path | None] = None
    """File to make: .ply keeps every bit; .compressed.ply, .spz and .splat are smaller; .glb is
    glTF; .html is a page for any browser, with before and after. Or name it with -o."""
    output: OptionalOutput = None
    """File to make, where it does not follow the scene."""
    sh_degree: Literal[0, 1, 2, 3] | None = None
    """Leave out how colours change with the view, above this degree; 0 keeps one colour each."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.places import refuse_file
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.export import export

        file = self.file or self.output
        if file is None or (self.file and self.output):
            raise StyleSplatError(f"Name one file: `stylesplat export {self.scene} FILE`.")
        refuse_file(file, overwrite=self.overwrite)
        scene = open(self.scene)
        export(scene, file, overwrite=self.overwrite, sh_degree=self.sh_degree)
        return {"file": file, "gaussians": len(scene.splats)}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        file = result["file"]
        count = f"{result['gaussians']:,} Gaussians, {size_of(file)}"
        plain = file.suffix == ".ply" and not file.name.endswith(".compressed.ply")
        opened_by = "SuperSplat opens it"
        if file.suffix.lower() == ".glb":
            opened_by = "What knows KHR_gaussian_splatting opens it, the rest shows points"
        if file.suffix.lower() == ".html":
            opened_by = "Any browser opens it, without a network"
        if plain and self.sh_degree is None:
            opened_by = "SuperSplat, Blender and other programs open it"
        yield f"{file}: {count}. {opened_by}."
        video = unused(self.scene, ".mp4")
        yield from next_lines(pasted("render", self.scene, "-o", video, "--views", "orbit"))
