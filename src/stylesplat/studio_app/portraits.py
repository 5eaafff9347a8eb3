"""Thumbnails of a scene's objects, made one by one when there is nothing else to do."""

from collections.abc import Callable, Sequence

import numpy as np

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.thumbnails import SIDE, Thumbnail, object_thumbnail, portrait_camera

BLANK = np.full((SIDE, SIDE, 3), 60, dtype=np.uint8)  # until there is one


class Portraits:
    """The thumbnails that there are so far."""

    def __init__(self, session: Session, ready: Callable[[], None]) -> None:
        """Begin with none.

        Args:
            session: Whose objects.
            ready: Is called in the worker's thread when there is one more.
        """
        self._session, self._ready = session, ready
        self._cameras = dict[str, tuple[object, Cameras | None]]()
        self._pictures = dict[str, tuple[object, Thumbnail]]()

    def of(self, names: Sequence[str]) -> list[Thumbnail]:
        """Those of some objects, blank or old ones where others are still to be made."""
        colors = self._session.state.scene.splats.sh0
        for name in names:
            if name not in self._pictures or self._pictures[name][0] is not colors:
                if self._session.painting:
                    continue
                self._session.ask(self._maker(name), kind=f"portrait {name}", patient=True)
        return [self._pictures.get(name, (None, BLANK))[1] for name in names]

    def _maker(self, name: str) -> Callable[[], None]:
        def make() -> None:
            scene = self._session.state.scene
            try:
                picked = self._session.masks.of(scene, name)
                camera = self._camera(name, picked)
            except StyleSplatError:  # it is gone, or shows nowhere
                return
            picture = BLANK if camera is None else object_thumbnail(scene.splats, camera, picked)
            before = self._pictures.get(name)
            self._pictures[name] = (scene.splats.sh0, picture)
            if before is None or not np.array_equal(before[1], picture):
                self._ready()

        return make

    def _camera(self, name: str, picked: object) -> Cameras | None:
        """Where an object is seen best; looked for once for as long as it stays what it is."""
        scene = self._session.state.scene
        known = self._cameras.get(name)
        if known is None or known[0] is not picked:
            try:
                camera = portrait_camera(scene.splats, scene.cameras, picked)  # pyright: ignore
            except StyleSplatError:
                camera = None
            self._cameras[name] = known = (picked, camera)
        return known[1]
