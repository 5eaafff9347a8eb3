"""`stylesplat studio`."""

import sys
import time
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import ClassVar, NoReturn

from tyro.conf import Positional

from stylesplat.cli.options import Device, Json


@dataclass(frozen=True)
class Studio:
    """Choose objects, paint them and compare, in the browser.

    Example: stylesplat studio garden-scene --styles Paintings
    """

    first: ClassVar = ("styles", "port")
    scene: Positional[Path]
    """Folder of the scene."""
    styles: Path | None = None
    """Folder of style pictures; more can be added in the browser."""
    port: int = 8080
    """Port, or the next free one."""
    host: str = "127.0.0.1"
    """Address to serve at; any other than 127.0.0.1 lets the network in, and asks for a token."""
    device: Device = "auto"
    """Where to paint; auto takes an NVIDIA GPU where there is one."""
    json: Json = False

    after_interruption: ClassVar[str] = "The studio is closed."

    def run(self) -> NoReturn:
        """Do it."""
        from stylesplat.atelier.opening import studio
        from stylesplat.progress import say

        sys.stdout = sys.stderr  # viser says where it serves
        opened = studio(
            self.scene,
            styles=self.styles,
            port=self.port,
            host=self.host,
            device=self.device,
            block=False,
        )
        sys.stdout = StringIO()  # and its thread, after our last line, that it no longer does
        say("Ctrl-C closes the studio; what is not saved is kept.")
        try:
            while True:
                time.sleep(1)
        finally:
            opened.close()
