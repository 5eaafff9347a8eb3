"""`stylesplat view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from stylesplat.cli.options import Json


@dataclass(frozen=True)
class View:
    """Look at a scene in the browser.

    Example: stylesplat view garden-wave
    """

    scene: Positional[Path]
    """Folder of the scene."""
    port: int = 8080
    """Port on 127.0.0.1, or the next free one."""
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.view import view

        view(open(self.scene), port=self.port)
        return {}
