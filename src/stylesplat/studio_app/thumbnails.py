"""Thumbnails of objects, paintings and style pictures."""

import io
from collections.abc import Callable
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
        self._pictures = dict[str, tuple[Tensor, bytes]]()  # with the colours that each shows
        self._versions = dict[str, int]()

    def version(self, name: str) -> int:
        """The number of the thumbnail of an object, 0 without one; a missing one is asked for."""
        session, known = self._session, self._pictures.get(name)
        if not session.painting and (
            known is None or known[0] is not session.state.scene.splats.sh0
        ):
            session.ask(partial(self._make, name), kind=f"thumbnail {name}", patient=True)
        return self._versions.get(name, 0)

    def picture(self, name: str) -> bytes | None:
        known = self._pictures.get(name)
        return known[1] if known else None

    def camera(self, name: str) -> Cameras:
        """A small square view of an object.

        Raises:
            StyleSplatError: If it shows in no view.
        """
        scene = self._session.state.scene
        picked = self._session.masks.of(scene, name)
        own = picked[: len(scene.unpainted)]
        if name not in self._cameras or not torch.equal(self._cameras[name][0], own):
            camera = close_up(scene.unpainted, scene.cameras, own).at_most(SIDE)
            self._cameras[name] = own, camera
        return self._cameras[name][1]

    def _make(self, name: str) -> None:
        scene = self._session.state.scene
        before = self._pictures.get(name)
        if before is not None and before[0] is scene.splats.sh0:
            return
        try:
            picked = self._session.masks.of(scene, name)
            picture = object_picture(scene.splats, self.camera(name), picked)
        except StyleSplatError:  # it was deleted, or no view shows it
            picture = b""
        self._pictures[name] = scene.splats.sh0, picture
        if picture and (before is None or before[1] != picture):
            self._versions[name] = self._versions.get(name, 0) + 1
            self._on_ready()
