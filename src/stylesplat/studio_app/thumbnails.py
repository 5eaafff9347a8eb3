"""Thumbnails of objects and paintings."""

from contextlib import suppress
from functools import partial

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import close_up
from stylesplat.figures.pictures import to_uint8
from stylesplat.rendering.shares import colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.gallery import Files, jpeg
from stylesplat.studio_app.session import Session

SIDE = 160  # pixels along a thumbnail
CARD = 0.15  # grey around an object


@torch.no_grad()
def object_picture(splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]) -> bytes:
    """A JPEG of an object alone."""
    image, share = colors_and_coverage(splats, camera, picked)
    return jpeg(to_uint8(share * image + (1 - share) * CARD).cpu().numpy())


class ObjectThumbnails:
    """Thumbnails of the objects of a scene, which are made while the worker is idle."""

    def __init__(self, session: Session, files: Files) -> None:
        self._session, self._files = session, files
        self._cameras = dict[str, tuple[Tensor, Cameras]]()  # with the mask that each shows
        self._asked = dict[str, Splats]()  # the splats for which each was asked
        self._made = dict[str, tuple[Tensor, str]]()  # colours and opacities; the address

    def url(self, name: str) -> str:
        """The address of an object's thumbnail, or nothing; a missing one is asked for."""
        session, splats = self._session, self._session.state.scene.splats
        if not session.painting and self._asked.get(name) is not splats:
            self._asked[name] = splats
            session.ask(partial(self._make, name), kind=f"thumbnail {name}", patient=True)
        return self._made[name][1] if name in self._made else ""

    def paint_url(self, name: str) -> str:
        """The address of a picture of an object as it is now; nothing if no view shows it."""
        scene = self._session.state.scene
        with suppress(StyleSplatError):
            picked = self._session.masks.of(scene, name)
            return self._files.add(object_picture(scene.splats, self._camera(name), picked))
        return ""

    def _camera(self, name: str) -> Cameras:
        """A small square view of an object. Raises a StyleSplatError if no view shows it."""
        scene = self._session.state.scene
        own = self._session.masks.of(scene, name)[: len(scene.unpainted)]
        if name not in self._cameras or not torch.equal(self._cameras[name][0], own):
            camera = close_up(scene.unpainted, scene.cameras, own).at_most(SIDE)
            self._cameras[name] = own, camera
        return self._cameras[name][1]

    def _make(self, name: str) -> None:
        scene = self._session.state.scene
        with suppress(StyleSplatError):  # it was deleted
            picked, splats = self._session.masks.of(scene, name), scene.splats
            looks = torch.cat([splats.sh0[picked, 0], splats.opacities[picked, None]], dim=1)
            if name not in self._made or not torch.equal(self._made[name][0], looks):
                self._made[name] = looks, self.paint_url(name)
                self._session.ask(self._session.on_change.call, kind="thumbnails", patient=True)
