"""Small pictures of an object in every style: first its colours, then a draft of its strokes."""

from collections.abc import Iterator
from functools import partial
from itertools import count
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.figures.best_views import close_up
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.studio_app.gallery import Gallery, StylePicture
from stylesplat.studio_app.history import StudioState, require_picked
from stylesplat.studio_app.messages import Progress
from stylesplat.studio_app.paint_queue import preview_colors
from stylesplat.studio_app.session import Session, Stopped
from stylesplat.studio_app.thumbnails import SIDE, object_picture
from stylesplat.stylization.style import Style
from stylesplat.verbs.stylize import stylize

QUICK = {"quality": "draft", "steps": 24, "object_size": 112}
NAME = "object"


class StylePreviews:
    """Previews of all styles on what is picked."""

    def __init__(self, session: Session, gallery: Gallery, **options: Any) -> None:
        self._session, self._gallery, self._options = session, gallery, options
        self._urls, self._numbers = dict[str, str](), count(1)
        self._of: StudioState | None = None
        self._drafting = 0  # the number of the drafts that are under way

    def url(self, title: str) -> str:
        """The address of the preview in a style; empty without one of what is picked."""
        return self._urls.get(title, "") if self._is_current() else ""

    def try_all(self) -> None:
        """Show previews of all styles on what is picked, or remove them."""
        session, state = self._session, self._session.state
        there, self._of, self._drafting = self._is_current(), None, 0
        self._urls.clear()
        if there:
            session.on_change.call()
            return
        require_picked(state)
        scene, picked = state.scene, session.masks.together(state.scene, state.picked)
        assert picked is not None
        picked = picked[: len(scene.unpainted)]
        camera = close_up(scene.unpainted, scene.cameras, picked).at_most(SIDE)
        self._of = state
        for picture in [*self._gallery.pictures.values()]:
            job = partial(self._color, state, picture, camera, picked)
            session.ask(job, kind=f"try {picture.title}")
        if not session.painting:
            self._drafting = number = next(self._numbers)
            session.worker.go_on_with(self._drafts(number, state, camera, picked))

    def stop(self) -> None:
        """End the drafts; the previews that there are stay."""
        self._drafting = 0

    def _is_current(self) -> bool:
        return self._of is not None and self._of.picked == self._session.state.picked

    def _color(
        self, of: StudioState, style: StylePicture, camera: Cameras, picked: Bool[Tensor, " N"]
    ) -> None:
        if self._of is of and self._is_current():
            splats = preview_colors(of.scene.unpainted, picked, Style(style.path).read())
            self._keep(style, object_picture(splats, camera, picked))

    def _keep(self, style: StylePicture, content: bytes) -> None:
        self._urls[style.title] = self._gallery.files.add(content)
        self._session.on_change.call()

    def _drafts(
        self, number: int, of: StudioState, camera: Cameras, picked: Bool[Tensor, " N"]
    ) -> Iterator[None]:
        """Paint the object in one style after the other, until something else is asked for."""
        session, styles = self._session, [*self._gallery.pictures.values()]
        splats, everything = of.scene.unpainted[picked], torch.ones(int(picked.sum())).bool()
        alone = Scene(splats, of.scene.cameras, objects={NAME: SceneObject(everything)})
        options = {**self._options, "measured": False}

        def over() -> bool:
            return self._drafting != number or session.state is not of or session.painting

        what = ""
        try:
            for row, each in enumerate(styles):
                what = f"Drafts of {', '.join(of.picked)}: {row + 1} of {len(styles)}"
                session.progress = Progress(what, row / len(styles))
                session.on_progress.call()
                with session.listening(over):
                    found = stylize(alone, {NAME: Style(each.path, **QUICK)}, **options)
                if over():
                    return
                self._keep(each, object_picture(found.splats, camera, everything))
                yield
        except Stopped:
            return
        finally:
            if session.progress is not None and session.progress.what == what:
                session.progress = None
                session.on_change.call()
