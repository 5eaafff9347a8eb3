"""The panel Compare: intensities, before and after, and the variants that were painted."""

from typing import TYPE_CHECKING

from stylesplat.scene.compose import strengths_of
from stylesplat.studio_app.comparing import Variant, at_intensity, described, taken_back, variant_of
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.studio_state import State
from stylesplat.studio_app.thumbnails import grid
from stylesplat.studio_app.viewing import Compared, Stage
from stylesplat.studio_app.widgets import icon

if TYPE_CHECKING:
    import viser

MOST = 1.5  # intensity
NONE = "none"
VIEWS: dict[str, Compared] = {"after": "after", "before": "before", "split": "split"}


class ComparePanel:
    """How strong each painting is, and which others there are."""

    def __init__(self, server: "viser.ViserServer", session: Session, stage: Stage) -> None:
        """Add it to the container that is open."""
        self.session, self._stage, self._gui = session, stage, server.gui
        gui = server.gui
        self._show = gui.add_button_group(
            "Show", tuple(VIEWS), hint="Hold B to see what was before"
        )
        self._show.on_click(lambda _: stage.compare(VIEWS[self._show.value]))
        self.border = border = gui.add_slider("Split at %", 0, 100, 1, 50)
        border.on_update(lambda _: stage.compare("split", border.value / 100))
        before = gui.add_command("Before or after", icon=icon("switch-horizontal"))
        before.on_trigger(lambda _: self._toggle())
        self._folder = gui.add_folder("Intensity")
        with self._folder:
            self._told = gui.add_markdown("Nothing is painted.")
        self._sliders: dict[str, viser.GuiSliderHandle[float]] = {}
        self._wanted = dict[str, float]()  # what sliders were moved to, until it is so
        self._variants = list[Variant]()
        self._strip: viser.GuiImageHandle | None = None
        with gui.add_folder("Variants") as self._shelf:
            self._titles = gui.add_button_group("Back to", (NONE,), order=2.0)
            self._settings = gui.add_markdown("", order=3.0)
        self._titles.on_click(lambda _: self._back(self._titles.value))
        with gui.add_folder("Take back"):
            back = gui.add_button("Take the picked object's paint back", icon=icon("eraser"))
        back.on_click(lambda _: session.do(picked_taken_back))
        session.on_painted(self._painted)
        self.refresh()

    def refresh(self) -> None:
        """The state is another."""
        found = strengths_of(self.session.state.scene)
        self._told.visible = not found
        for name in self._sliders.keys() - found.keys():
            self._sliders.pop(name).remove()
        for name, intensity in found.items():
            if name not in self._sliders:
                self._sliders[name] = self._slider(name, intensity)
            slider = self._sliders[name]
            slider.disabled = self.session.painting
            if self._wanted.get(name, intensity) != intensity:
                continue  # it was moved on meanwhile
            self._wanted.pop(name, None)
            if slider.value != intensity:
                slider.value = intensity

    def _slider(self, name: str, intensity: float) -> "viser.GuiSliderHandle[float]":
        with self._folder:
            slider = self._gui.add_slider(name, 0.0, MOST, 0.05, intensity)

        @slider.on_update
        def _(event: "viser.GuiEvent") -> None:
            if event.client is None:  # we have set it ourselves
                return
            wanted = self._wanted[name] = float(slider.value)
            self.session.do(
                lambda state: at_intensity(state, name, wanted),
                merge=("intensity", name),
                kind=f"intensity {name}",
            )

        return slider

    def _toggle(self) -> None:
        self._stage.compare("after" if self._stage.compared == "before" else "before")

    def _painted(self, name: str, title: str) -> None:
        self._variants.append(variant_of(self.session, name, title))
        pictures = [variant.thumbnail for variant in self._variants]
        sheet = grid(pictures, captions(len(pictures), [v.title for v in self._variants]))
        self._titles.options = tuple(str(n + 1) for n in range(len(pictures)))
        self._settings.content = described(self._variants)
        if self._strip is None:
            with self._shelf:
                self._strip = self._gui.add_image(sheet, format="png", order=1.0)
        self._strip.image = sheet

    def _back(self, title: str) -> None:
        if title == NONE:
            return
        variant = self._variants[int(title) - 1]
        self.session.do(lambda _: self.session.history.at(variant.bookmark))


def captions(count: int, titles: list[str]) -> list[str]:
    """Numbered ones."""
    return [f"{number + 1} {titles[number]}" for number in range(count)]


def picked_taken_back(state: State) -> State:
    """Without the paint of what is picked."""
    for name in state.picked:
        state = taken_back(state, name)
    return state
