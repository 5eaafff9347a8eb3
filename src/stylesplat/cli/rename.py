"""`stylesplat rename`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from stylesplat.cli.next_steps import next_lines, stylize_command
from stylesplat.cli.options import Json, Verbose


@dataclass(frozen=True)
class Rename:
    """Give an object of a scene another name.

    Example: stylesplat rename garden-scene object vase
    """

    scene: Positional[Path]
    """Folder of the scene."""
    old: Positional[str]
    """What the object is called."""
    new: Positional[str]
    """What to call it."""
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.cli.select import picture_of
        from stylesplat.io.recovery import changing
        from stylesplat.io.scene_folder import open, revise
        from stylesplat.verbs.rename import rename

        picture, target = (picture_of(self.scene, name) for name in (self.old, self.new))
        with changing(self.scene):
            before = open(self.scene)
            after = rename(before, self.old, self.new)
            revise(before, after, self.scene)
            shown = picture.is_file()
            if shown:
                picture.replace(target)
        found = {"name": self.new, "was": self.old, **after.objects[self.new].how}
        return found | {"picture": target if shown else None}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        yield f"{result['was']} is called {result['name']} now."
        yield from next_lines(stylize_command(self.scene, self.new))
