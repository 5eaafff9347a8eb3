"""Small pictures of objects and paintings, and of what is picked in every style."""

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import close_up
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.images import jpeg
from stylesplat.rendering.weights import colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.gallery import Files, Gallery, StylePicture
from stylesplat.studio_app.history import StudioState, require_picked
from stylesplat.studio_app.messages import Progress
from stylesplat.studio_app.paint_queue import preview_colors
from stylesplat.studio_app.session import SESSION_BUSY, Session, Stopped
from stylesplat.stylization.style import Style
from stylesplat.verbs.stylize import stylize

THUMBNAIL_SIDE = 160  # pixels along a thumbnail
CARD = 0.15  # grey around an object
THUMBNAIL_QUICK = {"quality": "draft", "steps": 24, "object_size": 112}
NAME = "object"


@torch.no_grad()
def object_picture(splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]) -> bytes:
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

    def paint_picture(self, name: str) -> bytes:
        """A picture of an object as it is now; nothing if no view shows it."""
        scene = self._session.state.scene
        with suppress(StyleSplatError):
            picked = scene.to_splats(self._session.masks.of(scene, name))
            return object_picture(scene.splats, self._camera(name), picked)
        return b""

    def _camera(self, name: str) -> Cameras:
        """A small square view of an object. Raises a StyleSplatError if no view shows it."""
        scene = self._session.state.scene
        own = self._session.masks.of(scene, name)
        if name not in self._cameras or not torch.equal(self._cameras[name][0], own):
            camera = close_up(scene.base, scene.cameras, own).at_most(THUMBNAIL_SIDE)
            self._cameras[name] = own, camera
        return self._cameras[name][1]

    def _make(self, name: str) -> None:
        scene = self._session.state.scene
        with suppress(StyleSplatError):  # it was deleted
            picked, splats = scene.to_splats(self._session.masks.of(scene, name)), scene.splats
            looks = torch.cat([splats.sh0[picked, 0], splats.opacities[picked, None]], dim=1)
            if name not in self._made or not torch.equal(self._made[name][0], looks):
                picture = self.paint_picture(name)
                self._made[name] = looks, self._files.add(picture) if picture else ""
                self._session.ask(self._session.on_change.call, kind="thumbnails", patient=True)


class StylePreviews:
    def __init__(self, session: Session, gallery: Gallery, **options: Any) -> None:
        self._session, self._gallery = session, gallery
        self._options, self._urls = {**options, "measured": False}, dict[str, str]()
        self._of: StudioState | None = None
        self._stopped = False

    @property
    def urls(self) -> dict[str, str]:
        """The addresses of the previews of what is picked, by the titles of styles."""
        return self._urls if self._is_current() else {}

    def try_all(self) -> None:
        """Show previews of all styles on what is picked, or remove them."""
        session, state = self._session, self._session.state
        there, self._of = self._is_current(), None
        self._urls.clear()
        if there:
            session.on_change.call()
            return
        require_picked(state)
        if session.painting:
            raise StyleSplatError(SESSION_BUSY)
        self._of, self._stopped = state, False
        session.worker.set_background_task(self._steps(state))

    def stop(self) -> None:
        """End the drafts; the previews that there are stay."""
        self._stopped = True

    def _is_current(self) -> bool:
        of, now = self._of, self._session.state
        return of is not None and (of.picked, of.selection) == (now.picked, now.selection)

    def _keep(self, style: StylePicture, content: bytes) -> None:
        self._urls[style.title] = self._gallery.files.add(content)
        self._session.on_change.call()

    def _steps(self, of: StudioState) -> Iterator[None]:
        """Paint the object in one style after the other, until something else is asked for."""
        session, styles = self._session, [*self._gallery.pictures.values()]
        base, picked = of.scene.base, session.masks.picked(of)
        assert picked is not None
        camera = close_up(base, of.scene.cameras, picked).at_most(THUMBNAIL_SIDE)
        alone, everything = base[picked], torch.ones(int(picked.sum()), dtype=torch.bool)
        scene = Scene(alone, of.scene.cameras, objects={NAME: SceneObject(everything)})

        def over() -> bool:
            return self._stopped or self._of is not of or session.state is not of

        what = f"Drafts of {', '.join(of.picked) or 'the selection'}"
        try:
            for style in styles:
                splats = preview_colors(base, picked, Style(style.path).read())
                self._keep(style, object_picture(splats, camera, picked))
                yield
                if over():
                    return
            for row, style in enumerate(styles):
                progress = Progress(f"{what}: {row + 1} of {len(styles)}", row / len(styles))
                session.progress = progress
                session.on_progress.call()
                with session.listening(lambda: over() or session.painting):
                    styled = stylize(
                        scene, {NAME: Style(style.path, **THUMBNAIL_QUICK)}, **self._options
                    )
                if over():
                    return
                self._keep(style, object_picture(styled.splats, camera, everything))
                yield
        except Stopped:
            return
        finally:
            if session.progress is not None and session.progress.what.startswith(what):
                session.progress = None
                session.on_change.call()
