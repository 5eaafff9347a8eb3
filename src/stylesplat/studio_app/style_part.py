"""The part of a style picture that is painted with: a rectangle that is drawn on it."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.figures.compositing import to_uint8
from stylesplat.studio_app.gallery import Exhibit, Gallery
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.wire import TITLE
from stylesplat.stylization.style_image import read_style

if TYPE_CHECKING:
    import viser

WHOLE = (0.0, 100.0)  # percent
NONE = "none"
SIDE = 420  # pixels of the picture that is drawn on, along the longer side
DIMMED = 0.3  # of the light that is left outside the part
RIM = (255, 160, 20)

Region = tuple[int, int, int, int]


class StylePart:
    """A picture to draw on, and two sliders that say the same in percent."""

    def __init__(self, gui: "viser.GuiApi", session: Session, gallery: Gallery) -> None:
        """Add it to the container that is open."""
        self._session, self._gallery = session, gallery
        self._of: tuple[Exhibit, UInt8[np.ndarray, "H W 3"]] | None = None
        with gui.add_folder("Part of a picture", expand_by_default=False):
            self._add(gui)
        self.hung()

    def _add(self, gui: "viser.GuiApi") -> None:
        self._titles: viser.GuiDropdownHandle[str] = gui.add_dropdown("Picture", [NONE], order=20.0)
        blank = np.zeros((1, 1, 3), np.uint8)
        self._sheet = gui.add_image(blank, label=TITLE, format="jpeg", order=21.0, visible=False)
        self._across = gui.add_multi_slider("Across %", 0.0, 100.0, 1.0, WHOLE, order=22.0)
        self._down = gui.add_multi_slider("Down %", 0.0, 100.0, 1.0, WHOLE, order=23.0)
        for control in (self._titles, self._across, self._down):
            control.on_update(lambda _: self._session.ask(self.show, kind="part"))

    @property
    def percent(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """From left to right and from top to bottom."""
        return tuple(map(float, self._across.value)), tuple(map(float, self._down.value))

    def region(self, size: tuple[int, int]) -> Region | None:
        """The part in pixels of a picture so large: x0, y0, x1, y1; None for all of it."""
        return None if self.percent == (WHOLE, WHOLE) else region_of(*self.percent, size)

    def hung(self) -> None:
        """The gallery is another: in the worker's thread."""
        titles = tuple(each.title for each in self._gallery.exhibits)
        if titles:
            self._titles.options = titles
            self.show()

    def draw(self, part: tuple[float, float, float, float]) -> None:
        """Somebody has drawn a rectangle: left, top, right, bottom, in shares of the picture."""
        left, top, right, bottom = (round(100 * each) for each in part)

        def job() -> None:
            self._across.value, self._down.value = (left, right), (top, bottom)
            self.show()

        self._session.ask(job, kind="drawn part")

    def show(self) -> None:
        """Draw the picture, and the part: in the worker's thread."""
        if self._titles.value == NONE:
            return
        exhibit = self._gallery[self._titles.value]
        if self._of is None or self._of[0] is not exhibit:
            self._of = exhibit, reduced(exhibit)
        image = framed(self._of[1], *self.percent)
        self._sheet.visible = True
        self._sheet.image = image


def region_of(across: tuple[float, ...], down: tuple[float, ...], size: tuple[int, int]) -> Region:
    """Shares of a picture in percent as its pixels: x0, y0, x1, y1."""
    (x0, x1), (y0, y1) = (
        [round(share * length / 100) for share in shares]
        for shares, length in ((across, size[0]), (down, size[1]))
    )
    return x0, y0, x1, y1


def reduced(exhibit: Exhibit) -> UInt8[np.ndarray, "H W 3"]:
    """A style picture, small enough for a panel.

    Raises:
        StyleSplatError: If its file is gone.
    """
    try:
        picture = Image.fromarray(to_uint8(read_style(exhibit.path)).numpy())
    except StyleSplatError as error:
        raise StyleSplatError(f"{exhibit.title} cannot be shown any more: {error}") from error
    picture.thumbnail((SIDE, SIDE))
    return np.array(picture)


def framed(
    image: UInt8[np.ndarray, "H W 3"], across: tuple[float, ...], down: tuple[float, ...]
) -> UInt8[np.ndarray, "H W 3"]:
    """A picture, dark but for a part of it."""
    if (across, down) == (WHOLE, WHOLE):
        return image
    height, width = image.shape[:2]
    x0, y0, x1, y1 = region_of(across, down, (width, height))
    found = (DIMMED * image).astype(np.uint8)
    found[max(0, y0 - 2) : y1 + 2, max(0, x0 - 2) : x1 + 2] = RIM
    found[y0:y1, x0:x1] = image[y0:y1, x0:x1]
    return found
