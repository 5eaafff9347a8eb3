"""The panel Paint: a gallery of style pictures, settings, and how far the painting is."""

from typing import TYPE_CHECKING, Any

from stylesplat.studio_app.easel import Easel, styled
from stylesplat.studio_app.gallery import Gallery
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.style_part import StylePart
from stylesplat.studio_app.thumbnails import grid
from stylesplat.studio_app.widgets import icon
from stylesplat.stylization.config import StyleConfig

if TYPE_CHECKING:
    import viser

NONE = "none"
USUAL = StyleConfig()
HELP = "Pick an object, then click a picture's name: it is painted."


class PaintPanel:
    """Pictures to paint with."""

    def __init__(
        self, server: "viser.ViserServer", session: Session, easel: Easel, gallery: Gallery
    ) -> None:
        """Add it to the container that is open."""
        self.session, self.easel, self.gallery = session, easel, gallery
        self._gui = gui = server.gui
        self._told = gui.add_markdown(HELP, order=0.5)
        self._sheet: viser.GuiImageHandle | None = None
        self._titles = gui.add_button_group("Paint like", (NONE,), order=2.0)
        self._titles.on_click(lambda _: self._paint(self._titles.value))
        upload = gui.add_upload_button(
            "Add a picture", icon=icon("upload"), mime_type="image/*", order=3.0
        )

        @upload.on_upload
        def _(event: "viser.GuiEvent") -> None:
            file = upload.value
            session.ask(lambda: self._hang(file.name, file.content))

        with gui.add_folder("Settings", order=4.0, expand_by_default=False):
            self._settings()
        self._stop = gui.add_button("Stop", icon=icon("player-stop"), color="red", order=2.5)
        self._stop.on_click(lambda _: easel.stop())
        self._continue = gui.add_button("Continue", icon=icon("player-play"), order=2.6)
        self._continue.on_click(lambda _: easel.go_on())
        self._hung()
        self.refresh()

    def refresh(self) -> None:
        """The state is another."""
        self._stop.visible = self.session.painting
        self._continue.visible = self.easel.can_continue
        picked = ", ".join(self.session.state.picked)
        self._told.content = f"Click a picture's name to paint **{picked}**." if picked else HELP

    def _hang(self, name: str, content: bytes) -> None:
        exhibit = self.gallery.upload(name, content)
        self._hung()
        self.session.tell(f"Added {exhibit.title}.")

    def _hung(self) -> None:
        """The gallery is another."""
        exhibits = self.gallery.exhibits
        self.part.hung()
        self._titles.options = tuple(each.title for each in exhibits) or (NONE,)
        if exhibits:
            sheet = grid([e.thumbnail for e in exhibits], [e.title for e in exhibits])
            if self._sheet is None:
                self._sheet = self._gui.add_image(sheet, format="png", order=1.5)
            self._sheet.image = sheet

    def _paint(self, title: str) -> None:
        if title not in {each.title for each in self.gallery.exhibits}:
            return
        exhibit, names = self.gallery[title], self.session.state.picked
        settings = self._chosen(exhibit.size)

        def begin() -> None:
            self.easel.paint(names, styled(exhibit.path, **settings), title)

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
        """The settings that differ from the usual ones."""
        found: dict[str, Any] = {name: each.value for name, each in self.controls.items()}
        found = {name: value for name, value in found.items() if value != getattr(USUAL, name)}
        region = self.part.region(size)
        return found if region is None else {**found, "region": region}
