"""Thumbnails of objects, paintings and style pictures, in grids, and icons."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.compositing import to_uint8
from stylesplat.figures.object_sheet import CARD, close_up
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

    def __init__(self, session: Session, ready: Callable[[], None]) -> None:
        self._session, self._ready = session, ready
        self._cameras = dict[str, tuple[object, Cameras | None]]()
        self._pictures = dict[str, tuple[object, Thumbnail]]()

    def of(self, names: Sequence[str]) -> list[Thumbnail]:
        """The thumbnails of objects; those that are not made yet are blank, or older ones."""
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
            except StyleSplatError:  # it was deleted
                return
            picture = BLANK if camera is None else object_thumbnail(scene.splats, camera, picked)
            before = self._pictures.get(name)
            self._pictures[name] = (scene.splats.sh0, picture)
            if before is None or not np.array_equal(before[1], picture):
                self._ready()

        return make

    def _camera(self, name: str, picked: object) -> Cameras | None:
        """The camera of an object, found once."""
        scene = self._session.state.scene
        known = self._cameras.get(name)
        if known is None or known[0] is not picked:
            try:
                camera = thumbnail_camera(scene.splats, scene.cameras, picked)  # pyright: ignore
            except StyleSplatError:
                camera = None
            self._cameras[name] = known = (picked, camera)
        return known[1]


def icon(name: str) -> "viser.IconName":
    """A name of Tabler's icons."""
    return cast("viser.IconName", name)
