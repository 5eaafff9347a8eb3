"""`stylesplat view`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NoReturn

from tyro.conf import Positional

from stylesplat.cli.options import Json
from stylesplat.cli.serving import serve


@dataclass(frozen=True)
class View:
    """Look at a scene in the browser.

    Example: stylesplat view garden-wave
    """

    first: ClassVar = ("port",)
    scene: Positional[Path]
    """Folder of the scene."""
    port: int = 8080
    """Port on 127.0.0.1, or the next free one."""
    json: Json = False

    after_interruption: ClassVar[str] = "The viewer is closed."

    def run(self) -> NoReturn:
        """Do it."""
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.view import view

        def start() -> Callable[[], None]:
            return view(open(self.scene), port=self.port, block=False).stop

        serve(start, "Ctrl-C closes the viewer.")
