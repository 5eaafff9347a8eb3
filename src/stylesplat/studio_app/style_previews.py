"""Small pictures of an object in every style: first its colours, then a draft of its strokes."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import close_up
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.studio_app.gallery import Gallery, StylePicture
from stylesplat.studio_app.history import StudioState
from stylesplat.studio_app.paint_queue import make_style, preview_colors
from stylesplat.studio_app.session import Progress, Session, Stopped
from stylesplat.studio_app.thumbnails import SIDE, object_picture
from stylesplat.verbs.stylize_live import stylize_live

QUICK = {"quality": "draft", "steps": 24, "object_size": 112}
NAME = "object"


class StylePreviews:
    """Previews of all styles on what is picked."""

    def __init__(
        self, session: Session, gallery: Gallery, on_ready: Callable[[], None], **options: Any
    ) -> None:
        self._session, self._gallery, self._on_ready = session, gallery, on_ready
        self._options = options
        self._pictures, self._numbers = dict[str, tuple[int, bytes]](), count(1)
        self._of: StudioState | None = None
        self._drafting = 0  # the number of the drafts that are under way

    def version(self, title: str) -> int:
        """The number of the preview in a style; 0 without one of what is picked."""
        return self._pictures.get(title, (0, b""))[0] if self._is_current() else 0

    def picture(self, title: str) -> bytes | None:
        return self._pictures[title][1] if title in self._pictures else None

    def toggle(self) -> None:
        """Make them, or remove them if they are there."""
        session, state = self._session, self._session.state
        there, self._of, self._drafting = self._is_current(), None, 0
        self._pictures.clear()
        if there:
            self._on_ready()
            return
        picked = session.masks.together(state.scene, state.picked)
        if picked is None:
            raise StyleSplatError("Nothing is picked. Click an object first.")
        scene, picked = state.scene, picked[: len(state.scene.unpainted)]
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
            base = of.scene.unpainted
            splats = preview_colors(base, picked, make_style(style.path).read())
            self._keep(style, object_picture(splats, camera, picked))

    def _keep(self, style: StylePicture, content: bytes) -> None:
        self._pictures[style.title] = next(self._numbers), content
        self._on_ready()

    def _drafts(
        self, number: int, of: StudioState, camera: Cameras, picked: Bool[Tensor, " N"]
    ) -> Iterator[None]:
        """Paint the object in one style after the other, until something else is asked for."""
        session, styles = self._session, [*self._gallery.pictures.values()]
        splats, everything = of.scene.unpainted[picked], torch.ones(int(picked.sum())).bool()
        alone = Scene(splats, of.scene.cameras, objects={NAME: SceneObject(everything)})
        what = f"Drafts of {', '.join(of.picked)}"

        def over() -> bool:
            return self._drafting != number or session.state is not of or session.painting

        try:
            for row, each in enumerate(styles):
                share = row / len(styles)
                session.progress = Progress(f"{what}: {row + 1} of {len(styles)}", share)
                session.on_progress.call()
                style, live = make_style(each.path, **QUICK), None
                steps = stylize_live(alone, NAME, style, **self._options)
                while True:
                    with session.listening(over):
                        following = next(steps, None)
                    if over():
                        return
                    if following is None:
                        break
                    live = following
                    yield
                assert live is not None  # there is at least one step
                self._keep(each, object_picture(live.splats, camera, everything))
        except Stopped:
            return
        finally:
            if session.progress is not None and session.progress.what.startswith(what):
                session.progress = None
                session.on_change.call()
