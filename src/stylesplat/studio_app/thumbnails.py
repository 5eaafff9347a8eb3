"""Thumbnails of objects, paintings and style pictures, in grids, and icons."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import close_up
from stylesplat.figures.grid import CARD
from stylesplat.figures.pictures import to_uint8
from stylesplat.rendering.shares import colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.session import Session

if TYPE_CHECKING:
    import viser


SIDE = 132  # pixels along a picture
COLUMNS = 3
GAP, CAPTION, FONT_SIZE = 8, 22, 15  # pixels
RIM = (255, 160, 20)  # around what is picked
INK = (225, 226, 230)
LONGEST = 15  # characters of a caption

Thumbnail = UInt8[np.ndarray, "S S 3"]


@torch.no_grad()
def thumbnail_camera(splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]) -> Cameras:
    """A small square view of an object."""
    return close_up(splats, cameras, picked).at_most(SIDE)


@torch.no_grad()
def object_thumbnail(splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]) -> Thumbnail:
    image, share = colors_and_coverage(splats, camera, picked)
    card = image.new_tensor(CARD) / 255
    return to_uint8(share * image + (1 - share) * card).cpu().numpy()


def picture_thumbnail(picture: Float[Tensor, "H W 3"]) -> Thumbnail:
    pixels = Image.fromarray(to_uint8(picture).numpy())
    side = min(pixels.size)
    left, top = ((length - side) // 2 for length in pixels.size)
    square = pixels.crop((left, top, left + side, top + side))
    return np.array(square.resize((SIDE, SIDE), Image.Resampling.LANCZOS))


def thumbnail_grid(
    pictures: Sequence[Thumbnail], captions: Sequence[str], marked: Sequence[bool] = ()
) -> UInt8[np.ndarray, "H W 4"]:
    """Captioned pictures in rows of three on a transparent sheet; marked ones get a rim."""
    lines = -(-len(pictures) // COLUMNS)
    size = (COLUMNS * (SIDE + GAP) - GAP, lines * (SIDE + CAPTION + GAP) - GAP)
    sheet = Image.new("RGBA", size)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(FONT_SIZE)
    for number, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        line, column = divmod(number, COLUMNS)
        left, top = column * (SIDE + GAP), line * (SIDE + CAPTION + GAP)
        sheet.paste(Image.fromarray(picture), (left, top))
        if marked and marked[number]:
            draw.rectangle((left, top, left + SIDE - 1, top + SIDE - 1), outline=RIM, width=5)
        draw.text((left + 2, top + SIDE + 2), shorten(caption), INK, font)
    return np.array(sheet)


def shorten(text: str, longest: int = LONGEST) -> str:
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


BLANK = np.full((SIDE, SIDE, 3), 60, dtype=np.uint8)  # until it is made


class ObjectThumbnails:
    """Thumbnails of the objects of a scene, which are made while the worker is idle."""

    def __init__(self, session: Session, on_ready: Callable[[], None]) -> None:
        self._session, self._on_ready = session, on_ready
        self._cameras = dict[str, tuple[Tensor, Cameras]]()  # with the mask that each shows
        self._pictures = dict[str, tuple[Tensor, Thumbnail]]()  # with the colours that each shows

    def of(self, names: Sequence[str]) -> list[Thumbnail]:
        """The thumbnails of objects; those that are not made yet are blank, or older ones."""
        session = self._session
        for name in names:
            known = self._pictures.get(name)
            if not session.painting and (
                known is None or known[0] is not session.state.scene.splats.sh0
            ):
                session.ask(partial(self._make, name), kind=f"thumbnail {name}", patient=True)
        return [self._pictures[name][1] if name in self._pictures else BLANK for name in names]

    def _make(self, name: str) -> None:
        scene = self._session.state.scene
        try:
            picked = self._session.masks.of(scene, name)
            if name not in self._cameras or self._cameras[name][0] is not picked:
                camera = thumbnail_camera(scene.splats, scene.cameras, picked)
                self._cameras[name] = picked, camera
            picture = object_thumbnail(scene.splats, self._cameras[name][1], picked)
        except StyleSplatError:  # it was deleted, or no view shows it
            picture = BLANK
        before = self._pictures.get(name)
        self._pictures[name] = scene.splats.sh0, picture
        if before is None or not np.array_equal(before[1], picture):
            self._on_ready()


def icon(name: str) -> "viser.IconName":
    """A name of Tabler's icons."""
    return cast("viser.IconName", name)
