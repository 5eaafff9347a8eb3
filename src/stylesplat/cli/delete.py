"""`stylesplat delete`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from stylesplat.cli.options import Json, Verbose


@dataclass(frozen=True)
class Delete:
    """Forget a named object of a scene; its Gaussians stay, and so does their paint.

    Example: stylesplat delete garden-scene lid
    """

    scene: Positional[Path]
    """Folder of the scene."""
    name: Positional[str]
    """What the object is called."""
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.cli.select import picture_of
        from stylesplat.io.recovery import changing
        from stylesplat.io.scene_folder import open, revise
        from stylesplat.verbs.delete import delete

        picture = picture_of(self.scene, self.name)
        with changing(self.scene):
            before = open(self.scene)
            after = delete(before, self.name)
            revise(before, after, self.scene)
            picture.unlink(missing_ok=True)
        return {"deleted": self.name, "names": [*after.objects]}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was done, and what is left."""
        left = ", ".join(result["names"]) or "none"
        yield f"{self.scene}: nothing is called {result['deleted']} now. Names: {left}."
