"""`stylesplat studio`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NoReturn

from tyro.conf import Positional

from stylesplat.cli.options import Device, Json
from stylesplat.cli.serving import serve


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
    """Address to serve at; any other than 127.0.0.1 lets the network in."""
    device: Device = "auto"
    """Where to paint; auto takes an NVIDIA GPU where there is one."""
    json: Json = False

    after_interruption: ClassVar[str] = "The studio is closed."

    def run(self) -> NoReturn:
        """Do it."""
        from stylesplat.studio_app.studio import studio

        def start() -> Callable[[], None]:
            return studio(
                self.scene,
                styles=self.styles,
                port=self.port,
                host=self.host,
                device=self.device,
                block=False,
            ).close

        serve(start, "Ctrl-C closes the studio; what is not saved is kept.")
