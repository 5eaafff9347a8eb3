"""The object below the pointer is lit in the exact picture of whom the pointer belongs to."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.figures.browser import camera_of
from stylesplat.scene.cameras import Cameras
from stylesplat.studio_app.picking import object_at, pixel_of
from stylesplat.studio_app.viewing import Stage

if TYPE_CHECKING:
    import viser

Place = tuple[float, float]

FONT_SIZE = 15
AWAY = 14  # pixels from the pointer to a name
INK, CARD = (255, 255, 255), (28, 28, 32)


class Hover:
    """What is lit."""

    def __init__(self, stage: Stage, whole: Callable[[], bool]) -> None:
        """Begin with nothing.

        Args:
            stage: Whose pictures.
            whole: Whether a click would take a whole object now.
        """
        self._stage, self._whole = stage, whole
        self._lit = dict[int, tuple[int, str]]()

    @property
    def lit(self) -> dict[int, str]:
        """The names of what is lit, by browser."""
        return {client: name for client, (_, name) in self._lit.items()}

    def point(self, client: "viser.ClientHandle", at: Place | None) -> None:
        """A browser's pointer rests somewhere, in shares of its picture; or does no longer."""
        self._stage.session.ask(
            lambda: self._light(client, at), kind=f"hover {client.client_id}", patient=True
        )

    def name_at(self, camera: Cameras, at: Place) -> str | None:
        """The object that a click would take."""
        session = self._stage.session
        return object_at(session.state, session.masks, camera, pixel_of(camera, at))

    def _light(self, client: "viser.ClientHandle", at: Place | None) -> None:
        """In the worker's thread."""
        stage, number = self._stage, client.client_id
        if not stage.rest.showing(number) or stage.session.preview is not None:
            return
        motion = stage.rest.motion(number)
        since, before = self._lit.get(number, (motion, None))
        name = self.name_at(camera_of(client), at) if at and self._whole() else None
        if name == (before if since == motion else None):
            return
        if name is None or at is None:
            self._lit.pop(number, None)
            stage.rest.again(number)
            return
        self._lit[number] = motion, name
        picked = stage.session.masks.of(stage.session.state.scene, name)
        stage.rest.again(number, partial(self._look, picked, name, at))

    def _look(
        self, picked: Bool[Tensor, " N"], name: str, at: Place, camera: Cameras
    ) -> UInt8[np.ndarray, "H W 3"]:
        return labelled(self._stage.look(camera, picked), name, pixel_of(camera, at))


def labelled(
    image: UInt8[np.ndarray, "H W 3"], text: str, place: Place
) -> UInt8[np.ndarray, "H W 3"]:
    """A picture with a few words beside a pixel."""
    found = Image.fromarray(image)
    draw, font = ImageDraw.Draw(found), ImageFont.load_default(FONT_SIZE)
    _, _, width, height = draw.textbbox((0, 0), text, font)
    x = min(place[0] + AWAY, found.width - width - 8)
    y = min(place[1] + AWAY, found.height - height - 8)
    draw.rounded_rectangle((x - 5, y - 3, x + width + 5, y + height + 5), 4, CARD)
    draw.text((x, y), text, INK, font)
    return np.array(found)
