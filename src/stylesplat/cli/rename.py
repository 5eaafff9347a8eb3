"""`stylesplat rename`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import Positional

from stylesplat.cli.next_steps import next_lines, stylize_command
from stylesplat.cli.options import Json, OptionalOutput, Overwrite, Verbose
from stylesplat.cli.rewriting import rewritten


@dataclass(frozen=True)
class Rename:
    """Give an object of a scene another name.

    Example: stylesplat rename garden-scene object vase
    """

    first: ClassVar = ("output",)
    scene: Positional[Path]
    """Folder of the scene."""
    old: Positional[str]
    """What the object is called."""
    new: Positional[str]
    """What to call it."""
    output: OptionalOutput = None
    """Folder of a scene to make; without it the scene itself is changed."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.cli.select import picture_of
        from stylesplat.io.atomic import atomic_path, changing
        from stylesplat.io.files import read_bytes
        from stylesplat.verbs.rename import rename

        folder = self.output or self.scene
        picture, target = picture_of(self.scene, self.old), picture_of(folder, self.new)
        with changing(folder):
            shown = read_bytes(picture) if picture.is_file() else None
            after = rewritten(
                self.scene,
                self.output,
                lambda scene: rename(scene, self.old, self.new),
                overwrite=self.overwrite,
                names_only=True,
            )
            if shown is not None:
                with atomic_path(target) as file:
                    file.write_bytes(shown)
            if self.output is None:
                picture.unlink(missing_ok=True)
        found = {"name": self.new, "was": self.old, **after.objects[self.new].how}
        return found | {"scene": folder, "picture": None if shown is None else target}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        yield f"{result['was']} is called {result['name']} now."
        yield from next_lines(stylize_command(result["scene"], self.new))
