"""The panel Paint: the gallery, the settings, and the part of a picture to use."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.figures.pictures import to_uint8
from stylesplat.studio_app.gallery import Gallery, StylePicture
from stylesplat.studio_app.paint_queue import PaintQueue, make_style
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.thumbnails import icon, thumbnail_grid
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.style_image import read_style

if TYPE_CHECKING:
    import viser


TITLE = "Drag a rectangle for a part of it"  # label of the picture to draw on
WHOLE = (0.0, 100.0)  # percent
NONE = "none"
PART_SIDE = 420  # pixels of that picture along its longer side
DIMMED = 0.3  # of the brightness, outside the part
RIM = (255, 160, 20)

Region = tuple[int, int, int, int]


class StylePart:
    """The part of a style picture to use: a picture to draw on, and two sliders in percent."""

    def __init__(self, gui: "viser.GuiApi", session: Session, gallery: Gallery) -> None:
        self._session, self._gallery = session, gallery
        self._of: tuple[StylePicture, UInt8[np.ndarray, "H W 3"]] | None = None
        with gui.add_folder("Part of a picture", expand_by_default=False):
            self._add(gui)
        self.refresh()

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
        """Left and right, top and bottom."""
        return tuple(map(float, self._across.value)), tuple(map(float, self._down.value))

    def region(self, size: tuple[int, int]) -> Region | None:
        """The part in pixels of a picture of this size; None for the whole picture."""
        return None if self.percent == (WHOLE, WHOLE) else region_in_pixels(*self.percent, size)

    def refresh(self) -> None:
        if self._gallery.pictures:
            self._titles.options = tuple(self._gallery.pictures)
            self.show()

    def draw(self, part: tuple[float, float, float, float]) -> None:
        """Take a rectangle that was drawn: left, top, right, bottom, in shares of the picture."""
        left, top, right, bottom = (round(100 * each) for each in part)

        def job() -> None:
            self._across.value, self._down.value = (left, right), (top, bottom)
            self.show()

        self._session.ask(job, kind="drawn part")

    def show(self) -> None:
        if self._titles.value == NONE:
            return
        style_picture = self._gallery.pictures[self._titles.value]
        if self._of is None or self._of[0] is not style_picture:
            self._of = style_picture, shrink_picture(style_picture)
        image = highlight_region(self._of[1], *self.percent)
        self._sheet.visible = True
        self._sheet.image = image


def region_in_pixels(
    across: tuple[float, ...], down: tuple[float, ...], size: tuple[int, int]
) -> Region:
    """A part in percent as pixels: x0, y0, x1, y1."""
    (x0, x1), (y0, y1) = (
        [round(share * length / 100) for share in shares]
        for shares, length in ((across, size[0]), (down, size[1]))
    )
    return x0, y0, x1, y1


def shrink_picture(style_picture: StylePicture) -> UInt8[np.ndarray, "H W 3"]:
    """A style picture at the size of the panel."""
    try:
        picture = Image.fromarray(to_uint8(read_style(style_picture.path)).numpy())
    except StyleSplatError as error:
        raise StyleSplatError(f"{style_picture.title} cannot be shown any more: {error}") from error
    picture.thumbnail((PART_SIDE, PART_SIDE))
    return np.array(picture)


def highlight_region(
    image: UInt8[np.ndarray, "H W 3"], across: tuple[float, ...], down: tuple[float, ...]
) -> UInt8[np.ndarray, "H W 3"]:
    """A picture that is dark outside a part."""
    if (across, down) == (WHOLE, WHOLE):
        return image
    height, width = image.shape[:2]
    x0, y0, x1, y1 = region_in_pixels(across, down, (width, height))
    found = (DIMMED * image).astype(np.uint8)
    found[max(0, y0 - 2) : y1 + 2, max(0, x0 - 2) : x1 + 2] = RIM
    found[y0:y1, x0:x1] = image[y0:y1, x0:x1]
    return found


USUAL = StyleConfig()
HELP = "Pick an object, then click a picture's name: it is painted."


class PaintPanel:
    """The controls of paintings."""

    def __init__(
        self, server: "viser.ViserServer", session: Session, queue: PaintQueue, gallery: Gallery
    ) -> None:
        self.session, self.queue, self.gallery = session, queue, gallery
        self._gui = gui = server.gui
        self._hint = gui.add_markdown(HELP, order=0.5)
        self._sheet: viser.GuiImageHandle | None = None
        self._titles = gui.add_button_group("Paint like", (NONE,), order=2.0)
        self._titles.on_click(lambda _: self._paint(self._titles.value))
        upload = gui.add_upload_button(
            "Add a picture", icon=icon("upload"), mime_type="image/*", order=3.0
        )

        @upload.on_upload
        def _(event: "viser.GuiEvent") -> None:
            file = upload.value
            session.ask(lambda: self._upload(file.name, file.content))

        with gui.add_folder("Settings", order=4.0, expand_by_default=False):
            self._settings()
        self._stop = gui.add_button("Stop", icon=icon("player-stop"), color="red", order=2.5)
        self._stop.on_click(lambda _: queue.stop())
        self._continue = gui.add_button("Continue", icon=icon("player-play"), order=2.6)
        self._continue.on_click(lambda _: queue.resume())
        self._refresh_gallery()
        self.refresh()

    def refresh(self) -> None:
        self._stop.visible = self.session.painting
        self._continue.visible = self.queue.can_continue
        picked = ", ".join(self.session.state.picked)
        self._hint.content = f"Click a picture's name to paint **{picked}**." if picked else HELP

    def _upload(self, name: str, content: bytes) -> None:
        style_picture = self.gallery.upload(name, content)
        self._refresh_gallery()
        self.session.tell(f"Added {style_picture.title}.")

    def _refresh_gallery(self) -> None:
        pictures = self.gallery.pictures
        self.part.refresh()
        self._titles.options = tuple(pictures) or (NONE,)
        if pictures:
            sheet = thumbnail_grid([each.thumbnail for each in pictures.values()], [*pictures])
            if self._sheet is None:
                self._sheet = self._gui.add_image(sheet, format="png", order=1.5)
            self._sheet.image = sheet

    def _paint(self, title: str) -> None:
        if title == NONE:
            return
        style_picture, names = self.gallery.pictures[title], self.session.state.picked
        settings = self._chosen(style_picture.size)

        def begin() -> None:
            self.queue.paint(names, make_style(style_picture.path, **settings), title)

        self.session.ask(begin)

    def _settings(self) -> None:
        gui = self._gui
        self.controls: dict[str, Any] = {
            "quality": gui.add_dropdown(
                "Quality", ("draft", "normal", "high"), initial_value=USUAL.quality
            ),
            "color": gui.add_dropdown(
                "Colour", ("style", "keep", "blend", "free"), initial_value=USUAL.color
            ),
            "scale": gui.add_slider("Stroke size", 0.5, 6.0, 0.1, USUAL.scale),
            "form": gui.add_slider("Keep form", 0.0, 1.5, 0.05, USUAL.form),
            "content": gui.add_slider("Keep content", 0.0, 1.0, 0.05, USUAL.content),
            "rotate": gui.add_slider("Rotate", 0.0, 345.0, 15.0, USUAL.rotate),
        }
        self.part = StylePart(gui, self.session, self.gallery)

    def _chosen(self, size: tuple[int, int]) -> dict[str, Any]:
        """The settings that differ from the defaults."""
        found: dict[str, Any] = {name: each.value for name, each in self.controls.items()}
        found = {name: value for name, value in found.items() if value != getattr(USUAL, name)}
        region = self.part.region(size)
        return found if region is None else {**found, "region": region}
