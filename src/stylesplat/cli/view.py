"""`stylesplat view` and `studio`: pages that are served until Ctrl-C."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NoReturn

import stylesplat as ss
from stylesplat.cli.options import Command, Device, SceneFolder
from stylesplat.progress import say


@dataclass(frozen=True)
class ViewCommand(Command):
    """Look at a scene in the browser.

    Example: stylesplat view garden-wave
    """

    scene: SceneFolder
    port: int = 8080
    """Port on 127.0.0.1, or the next free one."""
    after_interruption: ClassVar[str] = "The viewer is closed."

    def run(self) -> NoReturn:
        from stylesplat.studio_app.studio import until_interrupted

        viewer = ss.view(ss.open(self.scene), port=self.port, block=False)
        say("Ctrl-C closes the viewer.")
        until_interrupted(viewer.close)


@dataclass(frozen=True)
class StudioCommand(Command):
    """Choose objects, paint them and compare, in the browser.

    Example: stylesplat studio garden-scene --styles Paintings
    """

    scene: SceneFolder
    styles: Path | None = None
    """Folder of style pictures; more can be added in the browser."""
    port: int = 8080
    """Port, or the next free one."""
    host: str = "127.0.0.1"
    """Address to serve at; any other than 127.0.0.1 lets the network in."""
    device: Device = "auto"
    after_interruption: ClassVar[str] = "The studio is closed."

    def run(self) -> NoReturn:
        from stylesplat.studio_app.studio import until_interrupted

        options = {"port": self.port, "host": self.host, "device": self.device}
        studio = ss.studio(self.scene, styles=self.styles, block=False, **options)
        say("Ctrl-C closes the studio; what is not saved is kept.")
        until_interrupted(studio.close)
