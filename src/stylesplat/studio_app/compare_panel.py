"""The panel Compare: intensities, before and after, and the variants that were painted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from stylesplat.scene.compose import strengths_of
from stylesplat.studio_app.history import StudioState
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.thumbnails import (
    Thumbnail,
    icon,
    object_thumbnail,
    thumbnail_camera,
    thumbnail_grid,
)
from stylesplat.studio_app.viewport import Compared, Viewport
from stylesplat.stylization.config import StyleConfig, plain_settings
from stylesplat.verbs.adjust import adjust

if TYPE_CHECKING:
    import viser


@dataclass(frozen=True)
class Variant:
    """A painting that was finished, or stopped."""

    title: str
    bookmark: int
    """In the history."""
    thumbnail: Thumbnail
    settings: Mapping[str, object]


def set_intensity(state: StudioState, name: str, intensity: float) -> StudioState:
    if strengths_of(state.scene).get(name) == intensity:
        return state
    scene = adjust(state.scene, intensity, objects=name)
    note = f"{name} at {intensity:.0%}"
    return replace(state, scene=scene, glow=False, note=note)


def remove_paint(state: StudioState, name: str) -> StudioState:
    scene = adjust(state.scene, objects=name, undo=True)
    return replace(state, scene=scene, note=f"Removed the paint of {name}")


def make_variant(session: Session, name: str, title: str) -> Variant:
    """A variant of the last painting."""
    state = session.state
    splats, picked = state.scene.splats, session.masks.of(state.scene, name)
    camera = thumbnail_camera(splats, state.scene.cameras, picked)
    settings = {layer.object: layer.settings for layer in state.scene.layers}.get(name, {})
    return Variant(
        title=f"{name}: {title}",
        bookmark=session.history.bookmark(),
        thumbnail=object_thumbnail(splats, camera, picked),
        settings=settings,
    )


def describe_variants(variants: Sequence[Variant]) -> str:
    """A line for each variant: its number, its title, and its unusual settings."""
    usual = plain_settings(StyleConfig())
    lines = list[str]()
    for number, variant in enumerate(variants, 1):
        other = {key: value for key, value in variant.settings.items() if value != usual.get(key)}
        words = ", ".join(f"{key.replace('_', ' ')} {_word(other[key])}" for key in other)
        lines.append(f"{number}. {variant.title}: {words or 'usual settings'}")
    return "\n".join(lines)


def _word(value: object) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


MOST = 1.5  # intensity
NONE = "none"
VIEWS: dict[str, Compared] = {"after": "after", "before": "before", "split": "split"}


class ComparePanel:
    """The controls of intensities and variants."""

    def __init__(self, server: "viser.ViserServer", session: Session, viewport: Viewport) -> None:
        self.session, self._viewport, self._gui = session, viewport, server.gui
        gui = server.gui
        self._show = gui.add_button_group(
            "Show", tuple(VIEWS), hint="Hold B to see the scene before painting"
        )
        self._show.on_click(lambda _: viewport.compare(VIEWS[self._show.value]))
        self.border = border = gui.add_slider("Split at %", 0, 100, 1, 50)
        border.on_update(lambda _: viewport.compare("split", border.value / 100))
        before = gui.add_command("Before or after", icon=icon("switch-horizontal"))
        before.on_trigger(lambda _: self._toggle())
        self._folder = gui.add_folder("Intensity")
        with self._folder:
            self._hint = gui.add_markdown("Nothing is painted.")
        self._sliders: dict[str, viser.GuiSliderHandle[float]] = {}
        self._wanted = dict[str, float]()  # values of sliders that the scene does not have yet
        self._variants = list[Variant]()
        self._strip: viser.GuiImageHandle | None = None
        with gui.add_folder("Variants") as self._shelf:
            self._titles = gui.add_button_group("Back to", (NONE,), order=2.0)
            self._settings = gui.add_markdown("", order=3.0)
        self._titles.on_click(lambda _: self._back(self._titles.value))
        with gui.add_folder("Take back"):
            back = gui.add_button("Take the picked object's paint back", icon=icon("eraser"))
        back.on_click(lambda _: session.do(remove_picked_paint))
        session.on_painted.append(self._painted)
        self.refresh()

    def refresh(self) -> None:
        found = strengths_of(self.session.state.scene)
        self._hint.visible = not found
        for name in self._sliders.keys() - found.keys():
            self._sliders.pop(name).remove()
        for name, intensity in found.items():
            if name not in self._sliders:
                self._sliders[name] = self._slider(name, intensity)
            slider = self._sliders[name]
            slider.disabled = self.session.painting
            if self._wanted.get(name, intensity) != intensity:
                continue  # the slider was moved again meanwhile
            self._wanted.pop(name, None)
            if slider.value != intensity:
                slider.value = intensity

    def _slider(self, name: str, intensity: float) -> "viser.GuiSliderHandle[float]":
        with self._folder:
            slider = self._gui.add_slider(name, 0.0, MOST, 0.05, intensity)

        @slider.on_update
        def _(event: "viser.GuiEvent") -> None:
            if event.client is None:  # this program has set it
                return
            wanted = self._wanted[name] = float(slider.value)
            self.session.do(
                lambda state: set_intensity(state, name, wanted),
                merge=("intensity", name),
                kind=f"intensity {name}",
            )

        return slider

    def _toggle(self) -> None:
        self._viewport.compare("after" if self._viewport.compared == "before" else "before")

    def _painted(self, name: str, title: str) -> None:
        self._variants.append(make_variant(self.session, name, title))
        pictures = [variant.thumbnail for variant in self._variants]
        sheet = thumbnail_grid(
            pictures, [f"{n} {v.title}" for n, v in enumerate(self._variants, 1)]
        )
        self._titles.options = tuple(str(n + 1) for n in range(len(pictures)))
        self._settings.content = describe_variants(self._variants)
        if self._strip is None:
            with self._shelf:
                self._strip = self._gui.add_image(sheet, format="png", order=1.0)
        self._strip.image = sheet

    def _back(self, title: str) -> None:
        if title == NONE:
            return
        variant = self._variants[int(title) - 1]
        self.session.do(lambda _: self.session.history.at(variant.bookmark))


def remove_picked_paint(state: StudioState) -> StudioState:
    for name in state.picked:
        state = remove_paint(state, name)
    return state
