"""The panel Pick: the objects there are, and clicks and rectangles in the scene."""

from typing import TYPE_CHECKING, Any

from stylesplat.figures.browser import camera_of
from stylesplat.scene.content import content_of
from stylesplat.studio_app.box_handles import BoxHandles
from stylesplat.studio_app.hovering import Hover
from stylesplat.studio_app.picking import (
    How,
    alone,
    difference,
    forgotten,
    hidden,
    object_in,
    pick_at,
    pick_ball,
    pick_box,
    pick_names,
    pick_round,
    pick_words,
    pixel_of,
    renamed,
    resized,
    united,
)
from stylesplat.studio_app.portraits import Portraits
from stylesplat.studio_app.session import Change, Session
from stylesplat.studio_app.studio_state import State, names_in
from stylesplat.studio_app.thumbnails import grid
from stylesplat.studio_app.viewing import Stage
from stylesplat.studio_app.widgets import icon

if TYPE_CHECKING:
    import viser

OBJECT, BALL, BOX = "whole object", "ball", "box with handles"
BOXES: dict[str, How] = {"pick": "new", "add": "add", "take away": "away"}
HOW: dict[str, How] = {"": "new", "shift": "add", "cmd/ctrl": "away"}
SHARE = 0.05  # of its extent, by which an object grows or shrinks at a click
NOBODY = "none"
HELP = """**Click** an object in the picture. **Shift** adds, **Ctrl** takes away.
**Shift**-drag a rectangle to add what shows most in it, **Ctrl**-drag to take that away.
With a *ball*, the one that fits into the rectangle is added or taken away."""


class PickPanel:
    """What is picked, and what there is to pick."""

    def __init__(self, server: "viser.ViserServer", session: Session, stage: Stage) -> None:
        """Add it to the container that is open."""
        self.session, gui = session, server.gui
        self._handles = BoxHandles(stage)
        gui.add_markdown(HELP)
        self._sheet: viser.GuiImageHandle | None = None
        self._portraits = Portraits(session, self.refresh)
        self._folder = gui.add_folder("Objects")
        self._server = server
        self._names = list[str]()
        self.hover = Hover(stage, lambda: self._what.value == OBJECT)
        with self._folder:
            self._group = gui.add_button_group("Pick", (NOBODY,))
        self._group.on_click(self._named)
        self._summary = gui.add_markdown("")
        self._shapes(session)
        self._changes()
        for modifier, how in HOW.items():
            self._listen(modifier or None, how)
        self.refresh()

    def refresh(self) -> None:
        """The state is another."""
        state = self.session.state
        self._names = names_in(state.scene)
        self._group.options = tuple(self._names) or (NOBODY,)
        counts = [int(self.session.masks.of(state.scene, n).sum()) for n in state.picked]
        words = ", ".join(f"**{n}** ({c:,})" for n, c in zip(state.picked, counts, strict=True))
        self._summary.content = f"Picked: {words or 'nothing'}."
        pictures = self._portraits.of(self._names)
        if not pictures:
            return
        marked = [name in state.picked for name in self._names]
        sheet = grid(pictures, self._names, marked)
        if self._sheet is None:
            with self._folder:
                self._sheet = self._server.gui.add_image(sheet, format="png", order=-1.0)
        self._sheet.image = sheet

    def _shapes(self, session: Session) -> None:
        gui, scene = self._server.gui, session.state.scene
        extent = float(content_of(scene.splats).extent.size.norm())
        first = OBJECT if names_in(scene) else BALL
        self._what = gui.add_dropdown(
            "A click takes", (OBJECT, BALL, BOX), initial_value=first, hint="A ball corrects a pick"
        )
        self._inside = gui.add_button_group("In the box", tuple(BOXES), visible=False)
        self._inside.on_click(lambda _: self._box(BOXES[self._inside.value]))
        self._what.on_update(lambda _: self._chosen())
        largest = round(extent / 2, 4)
        self._radius = gui.add_slider("Radius", largest / 200, largest, largest / 200, largest / 10)
        self._text = gui.add_text("Words", "", hint="What to find, such as red chair")
        find = gui.add_button("Find words", icon=icon("search"))
        find.on_click(lambda _: self._do(lambda state: pick_words(state, self._text.value)))

    def _changes(self) -> None:
        gui = self._server.gui
        change = gui.add_button_group("Change", ("grow", "shrink", "unite", "difference", "forget"))
        actions: dict[str, Change] = {
            "grow": lambda state: resized(state, SHARE),
            "shrink": lambda state: resized(state, -SHARE),
            "unite": united,
            "difference": difference,
            "forget": forgotten,
        }
        change.on_click(lambda _: self._do(actions[change.value]))
        show = gui.add_button_group("Show", ("alone", "with the rest", "hide", "everything"))
        views: dict[str, Change] = {
            "alone": lambda state: alone(state, True),
            "with the rest": lambda state: alone(state, False),
            "hide": lambda state: hidden(state, True),
            "everything": lambda state: hidden(state, False),
        }
        show.on_click(lambda _: self._do(views[show.value]))
        name = gui.add_text("Name", "")
        button = gui.add_button("Rename", icon=icon("pencil"))
        button.on_click(lambda _: self._do(lambda state: renamed(state, name.value)))

    def _chosen(self) -> None:
        boxed = self._what.value == BOX
        self._inside.visible = boxed
        self.session.ask(lambda: self._handles.show(boxed))

    def _box(self, how: How) -> None:
        corners = self._handles.corners
        if corners is not None:
            self._do(lambda state: pick_box(state, *corners, how))

    def _do(self, change: Change) -> None:
        self.session.do(change)

    def _named(self, event: "viser.GuiEvent") -> None:
        name = self._group.value
        if name in self._names:
            self._do(lambda state: toggled(state, name))

    def _listen(self, modifier: Any, how: How) -> None:
        scene, session = self._server.scene, self.session

        @scene.on_click(modifier=modifier)
        def _(event: "viser.SceneClickEvent") -> None:
            camera, place = camera_of(event.client), event.screen_pos
            ball, radius = self._what.value == BALL, float(self._radius.value)

            def pick(state: State) -> State:
                pixel = pixel_of(camera, place)
                if ball:
                    return pick_ball(state, camera, pixel, radius, how)
                return pick_at(state, session.masks, camera, pixel, how)

            session.do(pick)

        if modifier is None:  # dragging turns the camera
            return

        @scene.on_rect_select(modifier=modifier)
        def _(event: "viser.SceneRectSelectEvent") -> None:
            camera, ball = camera_of(event.client), self._what.value == BALL
            low, high = pixel_of(camera, event.screen_min), pixel_of(camera, event.screen_max)

            def pick(state: State) -> State:
                if ball:
                    return pick_round(state, camera, low, high, how)
                found = object_in(state, session.masks, camera, low, high)
                return state if found is None else pick_names(state, [found], how)

            session.do(pick)


def toggled(state: State, name: str) -> State:
    """Pick an object, or if it is the pick, nothing."""
    return pick_names(state, [] if state.picked == (name,) else [name])
