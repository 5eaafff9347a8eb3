"""Views of a scene that are kept beside it, the photos' own, and the path through those kept."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Annotated

import msgspec
import torch
from jaxtyping import Float
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import refuse_unwritable
from stylesplat.io.images import jpeg
from stylesplat.io.json_yaml import read_json_as, write_json
from stylesplat.progress import say
from stylesplat.scene.cameras import Cameras, look_at, up_vector
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.virtual_cameras import has_rendered_views, path_of, smooth_path
from stylesplat.studio_app.gallery import Files
from stylesplat.studio_app.messages import ShortText, ViewCard, ViewVector
from stylesplat.studio_app.pictures import BEHIND, render_pixels
from stylesplat.studio_app.session import Session

VIEWS_FILE = "studio-views.json"  # in the scene's folder
MOST_KEPT, MOST_SHOWN = 100, 48  # views, and photos in the strip
CARD_SIDE = 160  # pixels of a picture of a view
NO_TURN = 1e-6  # of the length of what a view looks along, beside the up direction


class KeptView(msgspec.Struct, frozen=True):
    name: ShortText
    position: ViewVector
    target: ViewVector


class _Kept(msgspec.Struct):
    up: ViewVector | None = None
    views: Annotated[list[KeptView], Meta(max_length=MOST_KEPT)] = []


class KeptViews:
    def __init__(self, session: Session, files: Files, slopes: tuple[float, float]) -> None:
        """`slopes` are the width and the height of the first view's picture at distance 1."""
        self._session, self._files, self._slopes = session, files, slopes
        self._kept = _Kept()
        self._damaged = False
        place = session.folder / VIEWS_FILE
        if place.exists():
            try:
                self._kept = read_json_as(place, _Kept, "Keep the views again.")
            except StyleSplatError as error:
                self._damaged = True
                say(str(error))
        scene = session.state.scene
        count = 0 if has_rendered_views(scene) else len(scene.cameras)
        self._photos = evenly_spaced(range(count), MOST_SHOWN)
        self._pictures = dict[KeptView | int, str]()  # of views and of rows of photos
        self.wanted = False

    @property
    def up(self) -> Float[Tensor, "3"]:
        up = self._kept.up
        cameras = self._session.state.scene.cameras
        return up_vector(cameras) if up is None else torch.tensor(up, dtype=torch.float64)

    @property
    def levelled(self) -> ViewVector | None:
        """The up direction that was set by hand."""
        return self._kept.up

    def cards(self) -> list[ViewCard]:
        """The kept views, then photos; their pictures are made while the worker is idle."""
        if self.wanted:
            self._session.ask(self._draw_next, kind="views", patient=True)
        kept = [
            ViewCard(each.name, self._pictures.get(each, ""), each.position, each.target)
            for each in self._kept.views
        ]
        names = self._session.state.scene.cameras.names
        return kept + [
            ViewCard(names[row], self._pictures.get(row, ""), photo=row) for row in self._photos
        ]

    def show_views(self) -> None:
        """Begin to make the pictures of the strip."""
        self.wanted = True
        self._session.on_change.call()

    def keep_view(self, position: ViewVector, target: ViewVector, name: ShortText = "") -> None:
        views = self._kept.views
        if len(views) >= MOST_KEPT:
            raise StyleSplatError(f"{MOST_KEPT} views are kept, and no more. Remove one first.")
        taken = {each.name for each in views}
        names = (f"View {number}" for number in range(1, len(views) + 2))
        view = KeptView(name or next(n for n in names if n not in taken), position, target)
        _camera(view, self.up, self._slopes, (CARD_SIDE, CARD_SIDE))  # refuses what looks nowhere
        self._write(_Kept(self._kept.up, [*views, view]))

    def forget_view(self, number: int) -> None:
        views = [each for row, each in enumerate(self._kept.views) if row != number]
        self._write(_Kept(self._kept.up, views))

    def move_view(self, number: int, to: int) -> None:
        """Move a kept view to another place in their order, which is that of the path."""
        views = [*self._kept.views]
        if 0 <= number < len(views):
            views.insert(min(max(to, 0), len(views) - 1), views.pop(number))
            self._write(_Kept(self._kept.up, views))

    def level(self, up: ViewVector | None) -> None:
        """Say what is up, for the camera and for paths; None for what the photos say."""
        if up is not None:
            length = float(torch.tensor(up).norm())
            if length < NO_TURN:
                raise StyleSplatError("This direction has no length. Level the view again.")
            up = (up[0] / length, up[1] / length, up[2] / length)
        for each in self._kept.views:
            self._pictures.pop(each, None)
        self._write(_Kept(up, self._kept.views))

    def path(self, count: int, size: tuple[int, int]) -> Cameras:
        """The cameras of a smooth path through the kept views, as `render --path` takes it."""
        views = self._kept.views
        if len(views) < 2:
            raise StyleSplatError("A path leads through two kept views or more. Keep another one.")
        cameras = [_camera(each, self.up, self._slopes, size) for each in views]
        viewmats = torch.cat([each.viewmats for each in cameras]).double()
        focals = torch.stack([each.Ks[0, 1, 1] / size[1] for each in cameras])
        return smooth_path(viewmats, focals, count, size)

    def write(self) -> None:
        """Write them into the session's folder, which may be another one by now."""
        if self._kept.views or self._kept.up:
            self._write(self._kept)

    def _write(self, kept: _Kept) -> None:
        self._kept = kept
        self._session.on_change.call()
        place = self._session.folder / VIEWS_FILE
        refuse_unwritable(place.parent)
        if self._damaged and place.exists():
            place.replace(place.with_suffix(".damaged.json"))
        self._damaged = False
        write_json(msgspec.to_builtins(kept), place)

    def _draw_next(self) -> None:
        """Make the picture of one view, and tell the pages."""
        session, cameras = self._session, self._session.state.scene.cameras
        missing: list[tuple[KeptView | int, Callable[[], Cameras]]] = [
            (each, partial(_camera, each, self.up, self._slopes, (CARD_SIDE, CARD_SIDE * 3 // 4)))
            for each in self._kept.views
            if each not in self._pictures
        ]
        rows = [row for row in self._photos if row not in self._pictures]
        missing += [(row, partial(cameras.__getitem__, row)) for row in rows]
        if missing:
            key, camera = missing[0]
            self._pictures[key] = ""  # of a view along what has become the up direction
            with suppress(StyleSplatError):
                pixels = render_pixels(session.display.visible, camera().at_most(CARD_SIDE), BEHIND)
                self._pictures[key] = self._files.add(jpeg(pixels))
            session.ask(self._draw_next, kind="views", patient=True)
            session.on_change.call()


def _camera(
    view: KeptView, up: Tensor, slopes: tuple[float, float], size: tuple[int, int]
) -> Cameras:
    """The camera of a kept view, in whose picture everything is that the browser showed."""
    eye, target = (torch.tensor(each, dtype=torch.float64) for each in (view.position, view.target))
    ahead = target - eye
    if float(torch.linalg.cross(ahead, up.double()).norm()) < NO_TURN * float(ahead.norm() + 1e-30):
        raise StyleSplatError("This view looks straight up or down. Turn it a little.")
    focal = min(size[0] / slopes[0], size[1] / slopes[1]) / size[1]
    return path_of(look_at(eye[None], target, up.double()), torch.tensor([focal]), size)
