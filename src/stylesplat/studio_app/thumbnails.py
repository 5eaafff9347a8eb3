"""Small pictures of objects and paintings, and of what is picked in every style."""

import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import close_up
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.images import jpeg
from stylesplat.options import with_settings
from stylesplat.rendering.weights import colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import Layer
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.gallery import Files, Gallery
from stylesplat.studio_app.history import StudioState, require_picked
from stylesplat.studio_app.messages import Progress, ShortText
from stylesplat.studio_app.paint_queue import preview_colors, seconds_left
from stylesplat.studio_app.session import SESSION_BUSY, Session, Stopped
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.painter import SurveyedObject
from stylesplat.stylization.style import Style
from stylesplat.verbs.stylize import Live, stylize_live

THUMBNAIL_SIDE = 160  # pixels along a thumbnail
CARD_GREY = 0.15  # grey around an object
SELECTION = "the selection"  # the name of a temporary object


@torch.no_grad()
def object_picture(splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]) -> bytes:
    image, share = colors_and_coverage(splats, camera, picked)
    return jpeg(to_uint8(share * image + (1 - share) * CARD_GREY).cpu().numpy())


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

    def paint_picture(self, name: str, scene: Scene) -> bytes:
        """A picture of an object of a scene; nothing if no view shows it."""
        with suppress(StyleSplatError):
            picked = scene.to_splats(self._session.masks.of(scene, name))
            return object_picture(scene.splats, self._camera(name, scene), picked)
        return b""

    def _camera(self, name: str, scene: Scene) -> Cameras:
        """A small square view of an object. Raises a StyleSplatError if no view shows it."""
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
                picture = self.paint_picture(name, scene)
                self._made[name] = looks, self._files.add(picture) if picture else ""
                self._session.ask(self._session.on_change.call, kind="thumbnails", patient=True)


class StylePreviews:
    def __init__(
        self,
        session: Session,
        gallery: Gallery,
        keep_draft: Callable[[Layer, str], bool],
        **options: Any,
    ) -> None:
        """`keep_draft` gets each draft and the title of its picture.

        It returns whether more may come.
        """
        self._session, self._gallery, self._keep_draft = session, gallery, keep_draft
        self._options, self._urls = options, dict[str, str]()
        self._of: StudioState | None = None
        self._stopped = False

    @property
    def urls(self) -> dict[str, str]:
        """The addresses of the previews of what is picked, by the titles of styles."""
        return self._urls if self._is_current() else {}

    def try_all(
        self,
        settings: dict[str, Any] | None = None,
        regions: dict[ShortText, tuple[int, int, int, int]] | None = None,
    ) -> None:
        """Paint a draft of what is picked in every style, and keep them as variants.

        If previews are shown, they are removed instead. `regions` are the parts of pictures that
        are used, by their titles; those of other titles are ignored.
        """
        session, state = self._session, self._session.state
        there, self._of = self._is_current(), None
        self._urls.clear()
        if there:
            session.on_change.call()
            return
        require_picked(state)
        if session.painting:
            raise StyleSplatError(SESSION_BUSY)
        config = with_settings(StyleConfig(), {**(settings or {}), "quality": "draft"})
        parts = regions or {}
        styles = {
            each.title: Style(each.path, config=replace(config, region=parts.get(each.title)))
            for each in self._gallery.pictures.values()
        }
        self._of, self._stopped = state, False
        session.worker.set_background_task(self._steps(state, styles))

    def stop(self) -> None:
        """End the drafts; the previews that there are stay."""
        self._stopped = True

    def _is_current(self) -> bool:
        of, now = self._of, self._session.state
        if of is None or (of.picked, of.selection) != (now.picked, now.selection):
            return False
        if now.scene.objects is of.scene.objects:
            return True
        mask, earlier = self._session.masks.picked(now), self._session.masks.picked(of)
        assert mask is not None and earlier is not None
        return torch.equal(mask, earlier)

    def _show(self, title: str, splats: Splats, camera: Cameras, picked: Tensor) -> None:
        self._urls[title] = self._gallery.files.add(object_picture(splats, camera, picked))
        self._session.on_change.call()

    def _steps(self, of: StudioState, styles: Mapping[str, Style]) -> Iterator[None]:
        """Paint what is picked in one style after the other, until something else is painted."""
        session, base, picked = self._session, of.scene.base, self._session.masks.picked(of)
        assert picked is not None
        camera = close_up(base, of.scene.cameras, picked).at_most(THUMBNAIL_SIDE)
        scene, names = of.scene, of.picked
        if not names:
            scene, names = scene.with_object(SELECTION, SceneObject(picked)), (SELECTION,)
        what = f"Drafts of {', '.join(of.picked) or 'the selection'}"
        unread = set[str]()
        surveys, times = dict[str, SurveyedObject | None](), [(0.0, time.monotonic())]
        shown = below = scene.below(names[0])
        try:
            for title, style in styles.items():
                try:
                    pictures = style.read()
                except StyleSplatError as error:
                    session.tell(str(error), failure=True)
                    unread.add(title)
                else:
                    self._show(title, preview_colors(base, picked, pictures), camera, picked)
                yield
                self._raise_if_over(of)
            readable = [title for title in styles if title not in unread]
            drafts = [(title, name) for title in readable for name in names]
            for count, (title, name) in enumerate(drafts, 1):
                number = 1 + (count - 1) // len(names)
                words, left = f"{what}: {number} of {len(readable)}", seconds_left(times, None)
                session.progress = Progress(words, times[-1][0], left)
                session.on_progress.call()
                live = yield from self._draft(of, scene, name, styles[title], surveys.get(name))
                surveys[name] = live.survey
                layer = replace(live.layer, mask=None, blend="normal")
                if not self._keep_draft(layer, title):
                    return
                shown = shown.with_layer(layer)
                times.append((count / len(drafts), time.monotonic()))
                if count % len(names) == 0:
                    self._show(title, shown.splats, camera, shown.to_splats(picked))
                    shown = below
        except Stopped:
            return
        finally:
            if session.progress is not None and session.progress.what.startswith(what):
                session.progress = None
                session.on_change.call()

    def _draft(
        self,
        of: StudioState,
        scene: Scene,
        name: str,
        style: Style,
        survey: SurveyedObject | None,
    ) -> Generator[None, None, Live]:
        live, lives = None, stylize_live(scene, name, style, survey=survey, **self._options)
        while True:
            with self._session.listening(partial(self._is_over, of)):
                following = next(lives, None)
            if following is None:
                assert live is not None  # there is at least one step
                return live
            live = following
            yield
            self._raise_if_over(of)

    def _is_over(self, of: StudioState) -> bool:
        return (
            self._stopped or self._of is not of or self._session.painting or not self._is_current()
        )

    def _raise_if_over(self, of: StudioState) -> None:
        if self._is_over(of):
            raise Stopped
