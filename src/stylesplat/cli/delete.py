"""`stylesplat delete`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import Positional

from stylesplat.cli.options import Json, OptionalOutput, Overwrite, Verbose
from stylesplat.cli.rewriting import rewritten


@dataclass(frozen=True)
class Delete:
    """Forget a named object of a scene; its Gaussians stay, and so does their paint.

    Example: stylesplat delete garden-scene lid
    """

    first: ClassVar = ("output",)
    scene: Positional[Path]
    """Folder of the scene."""
    name: Positional[str]
    """What the object is called."""
    output: OptionalOutput = None
    """Folder of a scene to make; without it the scene itself is changed."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.cli.select import picture_of
        from stylesplat.io.atomic import changing
        from stylesplat.verbs.delete import delete

        folder = self.output or self.scene
        picture = picture_of(folder, self.name)
        with changing(folder):
            after = rewritten(
                self.scene,
                self.output,
                lambda scene: delete(scene, self.name),
                overwrite=self.overwrite,
                names_only=True,
            )
            picture.unlink(missing_ok=True)
        return {"scene": folder, "deleted": self.name, "names": [*after.objects]}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was done, and what is left."""
        left = ", ".join(result["names"]) or "none"
        yield f"{result['scene']}: nothing is called {result['deleted']} now. Names: {left}."
