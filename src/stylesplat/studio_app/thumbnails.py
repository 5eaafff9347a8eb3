"""Thumbnails of objects, paintings and style pictures."""

import io
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from PIL import Image
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import close_up
from stylesplat.figures.pictures import to_uint8
from stylesplat.rendering.shares import colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.session import Session

SIDE = 160  # pixels along a thumbnail
CARD = 0.15  # grey around an object

Pixels = UInt8[np.ndarray, "H W 3"]


def jpeg(pixels: Pixels, quality: int = 88) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return file.getvalue()


def shrunk(picture: Float[Tensor, "H W 3"], side: int) -> Pixels:
    """A picture whose longer side has at most so many pixels."""
    image = Image.fromarray(to_uint8(picture).numpy())
    image.thumbnail((side, side), Image.Resampling.LANCZOS)
    return np.array(image)


@torch.no_grad()
def object_picture(splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]) -> bytes:
    """A JPEG of an object alone."""
    image, share = colors_and_coverage(splats, camera, picked)
    return jpeg(to_uint8(share * image + (1 - share) * CARD).cpu().numpy())


class ObjectThumbnails:
    """Thumbnails of the objects of a scene, which are made while the worker is idle."""

    def __init__(self, session: Session, on_ready: Callable[[], None]) -> None:
        self._session, self._on_ready = session, on_ready
        self._cameras = dict[str, tuple[Tensor, Cameras]]()  # with the mask that each shows
        self._asked = dict[str, Splats]()  # the splats for which each was asked
        self._made = dict[str, tuple[Tensor, int, bytes]]()  # colours and opacities, version, JPEG

    def version(self, name: str) -> int:
        """The number of the thumbnail of an object, 0 without one; a missing one is asked for."""
        session, splats = self._session, self._session.state.scene.splats
        if not session.painting and self._asked.get(name) is not splats:
            self._asked[name] = splats
            session.ask(partial(self._make, name), kind=f"thumbnail {name}", patient=True)
        return self._made[name][1] if name in self._made else 0

    def picture(self, name: str) -> bytes | None:
        return self._made[name][2] if name in self._made else None

    def camera(self, name: str) -> Cameras:
        """A small square view of an object.

        Raises:
            StyleSplatError: If it shows in no view.
        """
        scene = self._session.state.scene
        own = self._session.masks.of(scene, name)[: len(scene.unpainted)]
        if name not in self._cameras or not torch.equal(self._cameras[name][0], own):
            camera = close_up(scene.unpainted, scene.cameras, own).at_most(SIDE)
            self._cameras[name] = own, camera
        return self._cameras[name][1]

    def _make(self, name: str) -> None:
        splats = self._session.state.scene.splats
        before, version, _ = self._made.get(name, (None, 0, b""))
        with suppress(StyleSplatError):  # it was deleted, or no view shows it
            picked = self._session.masks.of(self._session.state.scene, name)
            shown = torch.cat([splats.sh0[picked, 0], splats.opacities[picked, None]], dim=1)
            if before is not None and torch.equal(before, shown):
                return
            picture = object_picture(splats, self.camera(name), picked)
            self._made[name] = shown, version + 1, picture
            self._session.ask(self._on_ready, kind="thumbnails", patient=True)
