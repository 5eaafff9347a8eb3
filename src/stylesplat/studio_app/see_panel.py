"""The panel See: where the camera is, and what is behind the scene."""

from typing import TYPE_CHECKING

from stylesplat.studio_app.viewing import BEHIND, Stage, stand_at
from stylesplat.studio_app.widgets import icon

if TYPE_CHECKING:
    import viser

FLY = "Fly to photo"


def add_see_panel(server: "viser.ViserServer", stage: Stage) -> None:
    """Add it to the container that is open."""
    gui, scene = server.gui, stage.session.state.scene
    home = gui.add_button("Home", icon=icon("home"), hint="To what is picked, or where it began")

    @home.on_click
    def _(event: "viser.GuiEvent") -> None:
        if event.client is not None:
            stage.home(event.client)

    if len(scene.cameras) > 1:
        row = gui.add_slider(FLY, 1, len(scene.cameras), 1, 1, hint="The view of each photo")

        @row.on_update
        def _(event: "viser.GuiEvent") -> None:
            if event.client is not None:
                stage.flights.fly(event.client, stand_at(scene, scene.cameras[int(row.value) - 1]))

    frames = gui.add_checkbox("Show cameras", False, hint="Click one to fly there")
    frames.on_update(lambda _: stage.frames(frames.value))
    paper = gui.add_rgb("Background", _bytes(BEHIND))
    paper.on_update(lambda _: stage.paper(_colour(paper.value)))
    gui.add_markdown(
        "Drag to turn, right drag to move, wheel to come closer. To fly: **W A S D**, **Q** down, "
        "**E** up, arrows turn. At rest the picture is exact: all bands of colour."
    )


def _bytes(color: tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (round(255 * each) for each in color)
    return red, green, blue


def _colour(values: tuple[int, int, int]) -> tuple[float, float, float]:
    red, green, blue = (each / 255 for each in values)
    return red, green, blue
