"""The panel Pick: objects, clicks, rectangles and a box in the scene, and the pointer."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.figures.browser import camera_of
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import content_of, extent_of
from stylesplat.studio_app.history import StudioState, object_names
from stylesplat.studio_app.picking import (
    How,
    Pixel,
    forget_picked,
    hide_picked,
    isolate_picked,
    object_at,
    object_in,
    pick_at,
    pick_ball,
    pick_box,
    pick_names,
    pick_round,
    pick_words,
    pixel_of,
    rename_picked,
    resize_picked,
    subtract_picked,
    unite_picked,
)
from stylesplat.studio_app.session import Change, Session
from stylesplat.studio_app.thumbnails import ObjectThumbnails, icon, thumbnail_grid
from stylesplat.studio_app.viewport import Viewport

if TYPE_CHECKING:
    import viser


NODE = "/box"
COLOR = (255, 170, 40)
# Pairs of corners that differ in one axis, where bits of a corner are its axes
EDGES = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]


class BoxHandles:
    """A box in the scene with two handles."""

    def __init__(self, viewport: Viewport) -> None:
        self._viewport = viewport
        self._handles: list[viser.TransformControlsHandle] = []
        self._lines: viser.LineSegmentsHandle | None = None

    def show(self, show: bool) -> None:
        """Put the box around what is picked, or around the content; or remove it."""
        for handle in self._handles:
            handle.remove()
        if self._lines is not None:
            self._lines.remove()
        self._handles, self._lines = [], None
        if show:
            self._add()
        self._viewport.draw_over("box", show)

    @property
    def corners(self) -> tuple[list[float], list[float]] | None:
        """The lower corner and the upper one; None without a box."""
        if not self._handles:
            return None
        places = np.array([handle.position for handle in self._handles])
        return places.min(axis=0).tolist(), places.max(axis=0).tolist()

    def _add(self) -> None:
        session, scene = self._viewport.session, self._viewport.server.scene
        state = session.state
        picked = session.masks.together(state.scene, state.picked)
        splats = state.scene.splats
        extent = content_of(splats).extent if picked is None else extent_of(splats, picked)
        size = float(extent.size.norm()) / 8
        for name, corner in (("low", extent.low), ("high", extent.high)):
            handle = scene.add_transform_controls(
                f"{NODE}/{name}", scale=size, disable_rotations=True, position=corner.numpy()
            )
            handle.on_update(lambda _: self._moved())
            self._handles.append(handle)
        self._lines = scene.add_line_segments(
            f"{NODE}/edges",
            points=self._edges(),
            colors=COLOR,
            thickness=2.0,
            thickness_units="screen",
        )

    def _moved(self) -> None:
        if self._lines is not None and self._handles:
            self._lines.points = self._edges()

    def _edges(self) -> Float[np.ndarray, "12 2 3"]:
        low, high = (handle.position for handle in self._handles)
        bits = np.array([[row >> axis & 1 for axis in range(3)] for row in range(8)])
        return np.where(bits, high, low)[np.array(EDGES)].astype(np.float32)


FONT_SIZE = 15
AWAY = 14  # pixels from the pointer to a name
INK, CARD = (255, 255, 255), (28, 28, 32)


class Hover:
    """Lights the object below the pointer of each browser."""

    def __init__(self, viewport: Viewport, whole: Callable[[], bool]) -> None:
        self._viewport, self._whole = viewport, whole
        self._lit = dict[int, tuple[int, str]]()

    @property
    def lit(self) -> dict[int, str]:
        """The name of the lit object, by browser."""
        return {client: name for client, (_, name) in self._lit.items()}

    def point(self, client: "viser.ClientHandle", at: Pixel | None) -> None:
        """Light what is below a pointer, whose place is a share of the picture; None for none."""
        self._viewport.session.ask(
            lambda: self._light(client, at), kind=f"hover {client.client_id}", patient=True
        )

    def name_at(self, camera: Cameras, at: Pixel) -> str | None:
        """The object that a click would pick."""
        session = self._viewport.session
        return object_at(session.state, session.masks, camera, pixel_of(camera, at))

    def _light(self, client: "viser.ClientHandle", at: Pixel | None) -> None:
        viewport, number = self._viewport, client.client_id
        if not viewport.rest.showing(number) or viewport.session.preview is not None:
            return
        motion = viewport.rest.motion(number)
        since, before = self._lit.get(number, (motion, None))
        name = self.name_at(camera_of(client), at) if at and self._whole() else None
        if name == (before if since == motion else None):
            return
        if name is None or at is None:
            self._lit.pop(number, None)
            viewport.rest.again(number)
            return
        self._lit[number] = motion, name
        picked = viewport.session.masks.of(viewport.session.state.scene, name)
        viewport.rest.again(number, partial(self._look, picked, name, at))

    def _look(
        self, picked: Bool[Tensor, " N"], name: str, at: Pixel, camera: Cameras
    ) -> UInt8[np.ndarray, "H W 3"]:
        return draw_label(self._viewport.look(camera, picked), name, pixel_of(camera, at))


def draw_label(
    image: UInt8[np.ndarray, "H W 3"], text: str, place: Pixel
) -> UInt8[np.ndarray, "H W 3"]:
    """A picture with a text beside a pixel."""
    found = Image.fromarray(image)
    draw, font = ImageDraw.Draw(found), ImageFont.load_default(FONT_SIZE)
    _, _, width, height = draw.textbbox((0, 0), text, font)
    x = min(place[0] + AWAY, found.width - width - 8)
    y = min(place[1] + AWAY, found.height - height - 8)
    draw.rounded_rectangle((x - 5, y - 3, x + width + 5, y + height + 5), 4, CARD)
    draw.text((x, y), text, INK, font)
    return np.array(found)


OBJECT, BALL, BOX = "whole object", "ball", "box with handles"
BOXES: dict[str, How] = {"pick": "new", "add": "add", "take away": "away"}
HOW: dict[str, How] = {"": "new", "shift": "add", "cmd/ctrl": "away"}
SHARE = 0.05  # of its extent, by which an object grows or shrinks at a click
NOBODY = "none"
HELP = """**Click** an object in the picture. **Shift** adds, **Ctrl** takes away.
**Shift**-drag a rectangle to add what shows most in it, **Ctrl**-drag to take that away.
With a *ball*, the one that fits into the rectangle is added or taken away."""


class PickPanel:
    """The controls of picks."""

    def __init__(self, server: "viser.ViserServer", session: Session, viewport: Viewport) -> None:
        self.session, gui = session, server.gui
        self._handles = BoxHandles(viewport)
        gui.add_markdown(HELP)
        self._sheet: viser.GuiImageHandle | None = None
        self._thumbnails = ObjectThumbnails(session, self.refresh)
        self._folder = gui.add_folder("Objects")
        self._server = server
        self._names = list[str]()
        self.hover = Hover(viewport, lambda: self._what.value == OBJECT)
        with self._folder:
            self._group = gui.add_button_group("Pick", (NOBODY,))
        self._group.on_click(lambda _: self._pick_name(self._group.value))
        self._summary = gui.add_markdown("")
        self._shapes(session)
        self._changes()
        for modifier, how in HOW.items():
            self._listen(modifier or None, how)
        self.refresh()

    def refresh(self) -> None:
        state = self.session.state
        self._names = object_names(state.scene)
        self._group.options = tuple(self._names) or (NOBODY,)
        counts = [int(self.session.masks.of(state.scene, n).sum()) for n in state.picked]
        words = ", ".join(f"**{n}** ({c:,})" for n, c in zip(state.picked, counts, strict=True))
        self._summary.content = f"Picked: {words or 'nothing'}."
        pictures = self._thumbnails.of(self._names)
        if not pictures:
            return
        marked = [name in state.picked for name in self._names]
        sheet = thumbnail_grid(pictures, self._names, marked)
        if self._sheet is None:
            with self._folder:
                self._sheet = self._server.gui.add_image(sheet, format="png", order=-1.0)
        self._sheet.image = sheet

    def _shapes(self, session: Session) -> None:
        gui, scene = self._server.gui, session.state.scene
        extent = float(content_of(scene.splats).extent.size.norm())
        first = OBJECT if object_names(scene) else BALL
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
        find.on_click(lambda _: self.session.do(lambda state: pick_words(state, self._text.value)))

    def _changes(self) -> None:
        gui = self._server.gui
        change = gui.add_button_group("Change", ("grow", "shrink", "unite", "difference", "forget"))
        actions: dict[str, Change] = {
            "grow": lambda state: resize_picked(state, SHARE),
            "shrink": lambda state: resize_picked(state, -SHARE),
            "unite": unite_picked,
            "difference": subtract_picked,
            "forget": forget_picked,
        }
        change.on_click(lambda _: self.session.do(actions[change.value]))
        show = gui.add_button_group("Show", ("alone", "with the rest", "hide", "everything"))
        views: dict[str, Change] = {
            "alone": lambda state: isolate_picked(state, True),
            "with the rest": lambda state: isolate_picked(state, False),
            "hide": lambda state: hide_picked(state, True),
            "everything": lambda state: hide_picked(state, False),
        }
        show.on_click(lambda _: self.session.do(views[show.value]))
        name = gui.add_text("Name", "")
        button = gui.add_button("Rename", icon=icon("pencil"))
        button.on_click(lambda _: self.session.do(lambda state: rename_picked(state, name.value)))

    def _chosen(self) -> None:
        boxed = self._what.value == BOX
        self._inside.visible = boxed
        self.session.ask(lambda: self._handles.show(boxed))

    def _box(self, how: How) -> None:
        corners = self._handles.corners
        if corners is not None:
            self.session.do(lambda state: pick_box(state, *corners, how))

    def _pick_name(self, name: str) -> None:
        if name in self._names:
            self.session.do(
                lambda state: pick_names(state, [] if state.picked == (name,) else [name])
            )

    def _listen(self, modifier: Any, how: How) -> None:
        scene, session = self._server.scene, self.session

        @scene.on_click(modifier=modifier)
        def _(event: "viser.SceneClickEvent") -> None:
            camera, place = camera_of(event.client), event.screen_pos
            ball, radius = self._what.value == BALL, float(self._radius.value)

            def pick(state: StudioState) -> StudioState:
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

            def pick(state: StudioState) -> StudioState:
                if ball:
                    return pick_round(state, camera, low, high, how)
                found = object_in(state, session.masks, camera, low, high)
                return state if found is None else pick_names(state, [found], how)

            session.do(pick)
