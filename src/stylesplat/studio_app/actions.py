"""What the page may ask for, what that does to a session, and what the page is told of it.

Each action is a function of the state or a method of `Actions`, and its parameters are the message:
`pick_names(state, names, how)` is for `{"do": "pick", "names": ["vase"]}`. They run in the worker's
thread; methods for the browser `client`.
"""

import inspect
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial, reduce
from operator import or_
from typing import Annotated, Any, Literal, TypeVar, get_type_hints

import msgspec
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.figures.orbits import first_view, turned_view
from stylesplat.scene.cameras import Cameras, up_vector
from stylesplat.scene.content import content_of
from stylesplat.scene.framing import has_no_photos
from stylesplat.scene.scene import Scene
from stylesplat.studio_app import layers, picking
from stylesplat.studio_app import messages as m
from stylesplat.studio_app.autosave import SceneStore
from stylesplat.studio_app.commands import commands_text
from stylesplat.studio_app.exports import FORMATS, Exporter, render_png
from stylesplat.studio_app.gallery import MOST_BYTES, Gallery, StylePicture
from stylesplat.studio_app.history import KeptState, StudioState, object_names
from stylesplat.studio_app.layers import Variant, describe_settings, find_layer
from stylesplat.studio_app.paint_queue import PaintQueue, make_style
from stylesplat.studio_app.picking import object_in, pixel_of, region_of
from stylesplat.studio_app.pictures import MAP, PIXELS, Pictures, camera_of
from stylesplat.studio_app.session import Display, Session
from stylesplat.studio_app.style_previews import StylePreviews
from stylesplat.studio_app.thumbnails import ObjectThumbnails, object_picture
from stylesplat.stylization.config import StyleConfig
from stylesplat.verbs.render import orbit

NEAREST = 0.1  # world units from a photo's camera to its target, at least
USUAL = StyleConfig()
SETTINGS = (
    m.Setting("quality", "Quality", USUAL.quality, ("draft", "normal", "high")),
    m.Setting("color", "Colours", USUAL.color, ("style", "keep", "blend", "free")),
    m.Setting("scale", "Stroke size", USUAL.scale, low=0.5, high=6.0, step=0.1),
    m.Setting("rotate", "Stroke direction", USUAL.rotate, low=0.0, high=345.0, step=15.0),
    m.Setting("form", "Keep form", USUAL.form, low=0.0, high=1.5),
    m.Setting("content", "Keep pattern", USUAL.content),
)
CHANGES: dict[str, Callable[..., StudioState]] = {
    "pick": picking.pick_names,
    "pick_box": picking.pick_box,
    "pick_words": picking.pick_words,
    "resize": picking.resize_picked,
    "spread": picking.spread_picked,
    "unite": picking.unite_picked,
    "subtract": picking.subtract_picked,
    "forget": picking.forget_picked,
    "rename": picking.rename_picked,
    "hide": picking.hide_objects,
    "alone": picking.isolate_picked,
    "strength": layers.set_strength,
    "form": layers.set_form,
    "visible": layers.set_visible,
    "lock": layers.set_locked,
    "order": layers.move_layer,
    "remove_paint": layers.remove_paint,
}
"""Functions of the state that the page may call."""
Deliver = Callable[[int, str, bytes], None]
Method = TypeVar("Method", bound=Callable[..., Any])

METHODS = dict[str, Callable[..., StudioState | None]]()
"""Methods of `Actions` that the page may call."""
DRAGGED = ("strength", "form")  # of which one after the other is one step of undo


def action(method: Method) -> Method:
    """A method that the page may call. It may return another state."""
    METHODS[method.__name__] = method
    return method


class Actions:
    """Does what the page asks for."""

    def __init__(
        self,
        session: Session,
        *,
        queue: PaintQueue,
        gallery: Gallery,
        store: SceneStore | None,
        send: Callable[[int, str, bytes], None],
        deliver: Deliver,
        on_state: Callable[[], None],
    ) -> None:
        self.session, self.queue, self.gallery, self.store = session, queue, gallery, store
        self.pictures = Pictures(session, self._before, send)
        self.thumbnails = ObjectThumbnails(session, on_state)
        self.exporter = Exporter(session)
        self.previews = StylePreviews(session, gallery, on_state, **queue.options)
        self.variants, self.snapshots = list[Variant](), list[tuple[str, KeptState]]()
        self.compared: int | None = None
        self.client = 0
        self._deliver, self._on_state = deliver, on_state
        self._held = {} if store is None else {store.folder: session.saved}
        self._reference: tuple[object, object, Display] | None = None
        self._content = content_of(session.state.scene.splats).extent
        session.on_painted.append(self._painted)

    def act(self, client: int, message: m.Look | msgspec.Struct) -> None:
        """Ask for what a page wants; called in the server's thread."""
        if isinstance(message, m.Look):
            self.pictures.look(client, message)
            return
        name = str(type(message).__struct_config__.tag)
        values = msgspec.structs.asdict(message)

        if name in CHANGES:
            key = (name, values["name"]) if name in DRAGGED else None
            change = partial(CHANGES[name], **values)
            self.session.do(change, merge=key, kind=str(key or ""))
            return

        def job() -> None:
            self.client = client
            state = METHODS[name](self, **values)
            if state is not None:
                self.session.change(state)

        self.session.ask(job)

    @property
    def state(self) -> StudioState:
        return self.session.state

    @action
    def pick_at(
        self,
        place: m.Place,
        how: m.How = "new",
        radius: m.Positive | None = None,
        reach: m.Positive | None = None,
    ) -> StudioState:
        """Pick the object that shows at a place, the ball around it, or what looks alike there."""
        camera = self._camera()
        pixel = pixel_of(camera, place)
        if reach is not None:
            return picking.pick_alike(self.state, camera, pixel, reach, how)
        if radius is not None:
            return picking.pick_ball(self.state, camera, pixel, radius, how)
        return picking.pick_at(self.state, self.session.masks, camera, pixel, how)

    @action
    def pick_drawn(
        self,
        shape: m.Shape,
        points: m.Line,
        how: m.How = "new",
        radius: m.Share = 0.02,
        whole: bool = False,
    ) -> StudioState:
        """Pick what shows inside a line, or the whole object that shows most in a rectangle."""
        camera = self._camera(MAP)
        if whole:
            low, high = (pixel_of(camera, each) for each in _corners(points))
            found = object_in(self.state, self.session.masks, camera, low, high)
            return self.state if found is None else picking.pick_names(self.state, [found], how)
        inside = region_of(shape, points, camera.size, radius)
        return picking.pick_drawn(self.state, camera, inside, how)

    @action
    def paint(
        self,
        style: int,
        names: list[m.Text] | None = None,
        settings: dict[str, Any] | None = None,
        instead: bool = False,
    ) -> None:
        """Paint objects, by default those that are picked, like a style picture.

        `instead`: in place of their painting that is under way, whose picture stays meanwhile.
        """
        picture, given = self._style(style), settings or {}
        objects = self.session.state.picked if names is None else tuple(names)
        usual = {each.name: each.value for each in SETTINGS}
        unknown = given.keys() - usual.keys() - {"region"}
        if unknown:
            raise StyleSplatError(f"There is no setting {', '.join(sorted(unknown))}.")
        chosen = {k: v for k, v in given.items() if k not in usual or v != usual[k]}
        self.queue.paint(objects, make_style(picture.path, **chosen), picture.title, instead)

    @action
    def stop(self) -> None:
        self.previews.stop()
        self.queue.stop()

    @action
    def resume(self) -> None:
        self.queue.resume()

    @action
    def unqueue(self, number: int) -> None:
        self.queue.remove(number)

    @action
    def try_all(self) -> None:
        """Show previews of all styles on what is picked, or remove them."""
        self.previews.toggle()

    @action
    def use_variant(self, number: int) -> StudioState:
        return self._with_variant(self.state, number)

    @action
    def compare_with(self, number: int | None = None) -> None:
        """Show a variant on the left of the handle, or the scene before painting."""
        if number is not None:
            self._variant(number)
        self.compared = number
        self.session.on_change.call()

    @action
    def snapshot(self, name: m.Text) -> None:
        """Keep the whole scene as it is."""
        name = name.strip() or f"Snapshot {len(self.snapshots) + 1}"
        self.snapshots.append((name, KeptState(self.state)))
        self._on_state()

    @action
    def restore(self, number: int) -> StudioState:
        if not 0 <= number < len(self.snapshots):
            raise StyleSplatError("There is no such snapshot.")
        name, kept = self.snapshots[number]
        return replace(kept.state(), note=f"Restored {name}")

    @action
    def undo(self) -> None:
        self.session.step(-1)

    @action
    def redo(self) -> None:
        self.session.step(1)

    @action
    def save(self) -> None:
        self._store.save(self.session)

    @action
    def save_as(self, name: m.Text) -> None:
        self._store.save_as(self.session, name)

    @action
    def export(self, ending: m.Text) -> None:
        self.exporter.start(self.session.state.scene, ending, partial(self._send, self.client, ""))

    @action
    def cancel(self) -> None:
        """End the export."""
        self.exporter.cancel()

    @action
    def picture(self, width: int) -> None:
        """Render the view as a PNG."""
        look = self._look()
        content = render_png(self.session, look, width, self.pictures.background)
        self._send(self.client, "-view", ".png", content)

    @action
    def turntable(
        self,
        seconds: Annotated[float, msgspec.Meta(gt=0, le=60)] = 4.0,
        fps: Annotated[int, msgspec.Meta(ge=1, le=60)] = 30,
        width: Annotated[int, msgspec.Meta(ge=64, le=3840)] = 960,
        around: m.Text = "",
        path: Literal["photos", "circle", "swing"] = "photos",
    ) -> None:
        """Make a video around an object or the scene: where the photos were taken, or of the view
        of the page in a circle, or to and fro."""
        session, scene, frames = self.session, self.state.scene, max(2, round(seconds * fps))
        if session.painting:
            raise StyleSplatError("An object is being painted. Wait until it is done.")
        if path == "photos":
            cameras = orbit(scene, around=around or None, frames=frames)
        else:
            look = self._camera(10**9)
            box = session.masks.extent(scene, (around,)) if around else self._content
            cameras = turned_view(look, box.centre, up_vector(scene.cameras), frames, path)
        deliver = partial(self._send, self.client, "-turntable")
        self.exporter.film(cameras, width, fps, self.pictures.background, deliver)

    @action
    def background(self, color: tuple[m.Share, m.Share, m.Share]) -> None:
        self.pictures.background = color
        self.pictures.refresh()

    @property
    def _store(self) -> SceneStore:
        assert self.store is not None  # a page without one asks for nothing but looks
        return self.store

    def _look(self) -> m.Look:
        look = self.pictures.look_of(self.client)
        if look is None:
            raise StyleSplatError("This page has no picture yet.")
        return look

    def _camera(self, pixels: int = PIXELS) -> Cameras:
        return camera_of(self._look(), pixels)

    def _style(self, number: int) -> StylePicture:
        pictures = [*self.gallery.pictures.values()]
        if not 0 <= number < len(pictures):
            raise StyleSplatError("This style picture is not there any more.")
        return pictures[number]

    def _send(self, client: int, word: str, ending: str, content: bytes) -> None:
        name = self._store.folder.resolve().name + word + ending
        self._deliver(client, name, content)
        self.session.tell(f"{name}: {len(content) / 1e6:.1f} MB")

    def preview(self, number: int) -> bytes | None:
        return self.previews.picture(self._style(number).title)

    def _before(self) -> Display:
        """What lies on the left of the handle."""
        session, state = self.session, self.session.state
        scene = state.scene if self.compared is not None else state.scene.unpainted
        key = (self.compared, state.hidden, state.alone and state.picked)
        if self._reference is None or self._reference[0] is not scene or self._reference[1] != key:
            display = session.display_of(state)
            if self.compared is not None:
                display = session.display_of(self._with_variant(state, self.compared))
            else:
                base, hidden = state.scene.unpainted, display.hidden
                display = Display(base, None if hidden is None else hidden[: len(base)])
            self._reference = scene, key, display
        return self._reference[2]

    def _with_variant(self, state: StudioState, number: int) -> StudioState:
        variant = self._variant(number)
        return layers.use_layer(state, variant.layer, variant.title)

    def _variant(self, number: int) -> Variant:
        if not 0 <= number < len(self.variants):
            raise StyleSplatError("There is no such variant.")
        return self.variants[number]

    def _painted(self, name: str, title: str) -> None:
        """Keep a finished painting as a variant."""
        session = self.session
        scene = session.state.scene
        try:
            picture = object_picture(
                scene.splats, self.thumbnails.camera(name), session.masks.of(scene, name)
            )
        except StyleSplatError:  # it shows in no view
            picture = b""
        self.variants.append(Variant(find_layer(scene, name), title, picture))
        session.on_change.call()

    def hello(self, title: str, *, readonly: bool) -> m.Hello:
        scene = self.session.state.scene
        known = not has_no_photos(scene)
        view = first_view(scene.splats, scene.cameras if known else None)
        start: dict[str, Any] = {
            "position": view.position.tolist(),
            "target": view.target.tolist(),
            "up": view.up.tolist(),
            "slopes": view.slopes,
        }
        return m.Hello(
            title=title,
            readonly=readonly,
            start=start,
            photos=list(_photos(scene, self._content.centre)) if known else [],
            settings=list(SETTINGS),
            formats=FORMATS,
            extent=float(self._content.size.norm()),
            gaussians=len(scene.splats),
            max_bytes=MOST_BYTES,
        )

    def state_message(self) -> m.StateMessage:
        """All that the page shows; called in the worker's thread."""
        session, state = self.session, self.session.state
        scene, history = state.scene, session.history
        box = self._content if not state.picked else session.masks.extent(scene, state.picked)
        return m.StateMessage(
            objects=[self._object(name) for name in object_names(scene)],
            layers=[_layer_info(state, each.name) for each in scene.layers],
            variants=[self._variant_info(n, each) for n, each in enumerate(self.variants)],
            snapshots=[(n, name) for n, (name, _) in enumerate(self.snapshots)],
            styles=[self._style_info(n, e) for n, e in enumerate(self.gallery.pictures.values())],
            waiting=[m.JobInfo(each.number, each.name, each.title) for each in self.queue.waiting],
            alone=state.alone,
            painting=session.painting,
            can_continue=self.queue.can_continue,
            undo=history.undo_note,
            redo=history.redo_note,
            note=state.note,
            unsaved=session.unsaved,
            folder=str(self.store.folder if self.store else session.folder),
            commands=self._commands(),
            compared=self.compared,
            box=(_vector(box.low), _vector(box.high)),
        )

    def progress_message(self) -> m.ProgressMessage:
        found = self.session.progress or self.session.export
        if found is None:
            return m.ProgressMessage()
        return m.ProgressMessage(found.what, found.share, found.left, found.doing, found.export)

    def _object(self, name: str) -> m.ObjectInfo:
        session, state = self.session, self.session.state
        mask = session.masks.of(state.scene, name)
        extent = session.masks.extent(state.scene, (name,))
        return m.ObjectInfo(
            name=name,
            picked=name in state.picked,
            hidden=name in state.hidden,
            named=name in state.scene.objects,
            painted=name in state.scene.painted_objects,
            count=int(mask.sum()),
            thumbnail=self.thumbnails.version(name),
            centre=_vector(extent.centre),
            radius=float(extent.size.norm()) / 2,
        )

    def _variant_info(self, number: int, variant: Variant) -> m.VariantInfo:
        layer = variant.layer
        current = any(each.sh0 is layer.sh0 for each in self.state.scene.layers)
        settings = describe_settings(layer.settings)
        return m.VariantInfo(number, layer.object, variant.title, settings, current)

    def _style_info(self, number: int, picture: StylePicture) -> m.StyleInfo:
        version = self.previews.version(picture.title)
        return m.StyleInfo(number, picture.title, picture.size, version)

    def _commands(self) -> str:
        if self.store is None:
            return ""
        self._held[self.store.folder] = self.session.saved
        return commands_text(self.session.state, self.store.folder, self._held)


def _corners(points: list[m.Place]) -> tuple[m.Place, m.Place]:
    (x0, y0), (x1, y1) = points[0], points[-1]
    return (min(x0, x1), min(y0, y1)), (max(x0, x1), max(y0, y1))


def _layer_info(state: StudioState, name: str) -> m.LayerInfo:
    layer = find_layer(state.scene, name)
    names = (each.path.stem if each.path else "a picture" for each in layer.styles)
    title = ", ".join(names).replace("_", " ") or "recoloured"
    return m.LayerInfo(
        object=name,
        title=title,
        strength=layer.strength,
        form=layer.form,
        visible=layer.visible,
        locked=name in state.locked,
        settings=describe_settings(layer.settings),
    )


def _photos(scene: Scene, middle: torch.Tensor) -> Iterator[dict[str, Any]]:
    cameras = scene.cameras
    for row, name in enumerate(cameras.names):
        position = cameras.positions[row].double()
        axes = cameras.viewmats[row, :3, :3].double()
        distance = max(float((middle - position) @ axes[2]), NEAREST)
        width, height = cameras.sizes[row].tolist()
        slopes = width / float(cameras.Ks[row, 0, 0]), height / float(cameras.Ks[row, 1, 1])
        yield {
            "name": name,
            "position": position.tolist(),
            "target": (position + distance * axes[2]).tolist(),
            "right": axes[0].tolist(),
            "down": axes[1].tolist(),
            "slopes": slopes,
        }


def _vector(values: torch.Tensor) -> m.Vector:
    x, y, z = values.tolist()
    return x, y, z


def _struct_of(name: str, method: Callable[..., Any]) -> type[msgspec.Struct]:
    """The message for a method: its parameters."""
    hints = get_type_hints(method, include_extras=True)
    fields = list[Any]()
    for each in inspect.signature(method).parameters.values():
        if each.name not in ("self", "state"):
            default = () if each.default is each.empty else (each.default,)
            fields.append((each.name, hints[each.name], *default))
    return msgspec.defstruct(name, fields, tag_field="do", tag=name, forbid_unknown_fields=True)


MESSAGES = [_struct_of(name, method) for name, method in {**CHANGES, **METHODS}.items()]
DECODER = msgspec.json.Decoder(reduce(or_, MESSAGES, m.Look))
"""Reads what a page sends."""
