"""`stylesplat view`."""

import sys
import time
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import ClassVar, NoReturn

from tyro.conf import Positional

from stylesplat.cli.options import Json


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
        from stylesplat.progress import say
        from stylesplat.verbs.view import view

        sys.stdout = sys.stderr  # viser says where it serves
        server = view(open(self.scene), port=self.port, block=False)
        sys.stdout = StringIO()  # and its thread, after our last line, that it no longer does
        say("Ctrl-C closes the viewer.")
        try:
            while True:
                time.sleep(1)
        finally:
            server.stop()
