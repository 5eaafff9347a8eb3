"""What the page may ask for, and what that does to a session.

Each action is a function of the state or a method, and its parameters are the message:
`pick_names(state, names, how)` is for `{"do": "pick_names", "names": ["vase"]}`. They run in the
worker's thread; methods of `Actions` for the browser `client`. What returns a state changes it.
"""

import inspect
from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import msgspec

from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.figures.web_page import start_of
from stylesplat.io.images import jpeg
from stylesplat.io.layers import RECIPE
from stylesplat.io.style_pictures import MATERIALS, PREFIX
from stylesplat.options import PickSize
from stylesplat.scene.content import content_of
from stylesplat.scene.layers import RECOLOR, split_name
from stylesplat.scene.objects import free_name
from stylesplat.scene.virtual_cameras import has_rendered_views
from stylesplat.studio_app import edits as layers
from stylesplat.studio_app import messages as m
from stylesplat.studio_app import selecting as picking
from stylesplat.studio_app.brushes import Brushes
from stylesplat.studio_app.deliveries import Deliveries
from stylesplat.studio_app.files import FORMATS, SceneStore
from stylesplat.studio_app.gallery import (
    MOST_BYTES,
    Gallery,
    StylePicture,
    ThumbnailPixels,
    shrunk,
)
from stylesplat.studio_app.history import (
    StudioState,
    find_step,
    object_names,
    require_objects,
    require_picked,
)
from stylesplat.studio_app.history_files import HistoryFolder
from stylesplat.studio_app.paint_queue import PaintQueue
from stylesplat.studio_app.pictures import MAP, Pictures
from stylesplat.studio_app.reports import (
    layer_info,
    layer_title,
    object_info,
    photo_views,
    selection_info,
    step_cards,
    vector,
)
from stylesplat.studio_app.session import Display, Session, Stopped
from stylesplat.studio_app.thumbnails import ObjectThumbnails, StylePreviews
from stylesplat.studio_app.variants import Variants
from stylesplat.studio_app.views import KeptViews
from stylesplat.stylization.config import RecolorConfig, StyleConfig
from stylesplat.stylization.style import Style

T = TypeVar("T")

STEP_SIDE = 112  # pixels of the longer side of the picture of a step
RECOLORED = "recoloured"  # begins the name of what was a selection
DRAGGED = ("adjust_layer", "recolor")  # one after the other is one step of undo
SLOW = {
    "pick_at": "Looking for what belongs to the click",
    "pick_drawn": "Looking for what was drawn around",
    "pick_box": "Looking for what is in the box",
    "pick_words": "Looking for what the words mean",
    "resize_picked": "Growing or shrinking what is picked",
    "feather_picked": "Feathering what is picked",
    "picture": "Making the picture",
    "mask_drawn": "Painting the mask",
    "mend_drawn": "Mending",
    "pick_extreme": "Looking at all Gaussians",
    "save": "Saving",
    "save_as": "Saving",
    "step": "Going back or forth",
    "go_to": "Going back or forth",
}
"""What is said while an action takes long."""
NEVER_CANCELLED = ("save", "save_as")  # what nobody cancels


class Actions:
    def __init__(
        self,
        session: Session,
        gallery: Gallery,
        store: SceneStore | None,
        kept: HistoryFolder | None = None,
        is_local: bool = True,
        **options: Any,
    ) -> None:
        """`options` are those of `stylize_live`; without a store nothing can be changed.

        `is_local`: whether it serves its own machine alone.
        """
        self.session, self.gallery, self.readonly = session, gallery, store is None
        self._store, self._kept, self._is_local = store, kept, is_local
        self.queue = PaintQueue(session, **options)
        self.thumbnails = thumbnails = ObjectThumbnails(session, gallery.files)
        readonly = store is None
        self.variants = Variants(session, gallery.files, thumbnails, readonly=readonly)
        self.pictures = Pictures(session, self.variants.before)
        self.previews = StylePreviews(session, gallery, self.variants.keep_draft, **options)
        self._spot: tuple[object, StudioState, StudioState] | None = None
        """Where was picked last, what became of it, and what was before."""
        scene, variants = session.state.scene, self.variants
        self._content = content_of(scene.splats).extent
        self._start = start_of(scene.splats, None if has_rendered_views(scene) else scene.cameras)
        self.views = KeptViews(session, gallery.files, tuple(self._start["slopes"]))
        self.brushes = Brushes(self.pictures, self.queue)
        self.deliveries = files = Deliveries(self.pictures, self.views, gallery.files)
        self.pictures.on_rest.append(self._picture_step)
        session.on_painted.append(variants.keep_painted)
        changes = [picking.pick_names, picking.pick_box, picking.pick_words, picking.resize_picked]
        changes += [picking.unite_picked, picking.subtract_picked, picking.forget_picked]
        changes += [picking.rename_picked, picking.hide_objects, picking.feather_picked]
        changes += [picking.invert_picked, picking.name_selection, layers.adjust_layer]
        changes += [layers.set_visible, layers.set_locked, layers.move_layer, layers.remove_paint]
        changes += [layers.solo_layer, layers.set_blend, layers.mask_by_selection]
        changes += [layers.remove_mask, picking.pick_extreme]
        methods = [self.pick_at, self.pick_drawn, self.recolor, self.paint, self.stop]
        methods += [self.repaint_layer, self.copy_settings, self.remove_picked]
        methods += [self.brushes.mask_drawn, self.brushes.mend_drawn]
        methods += [self.brushes.guide_drawn]
        methods += [self.queue.resume, self.queue.remove, self.previews.try_all]
        methods += [variants.use_variant, variants.compare_with, variants.star_variant]
        methods += [variants.name_variant, variants.delete_variant]
        methods += [self.snapshot, self.restore, self.forget_snapshot]
        methods += [self.add_style, self.forget_style]
        methods += [session.step, session.go_to, self.background]
        methods += [files.export, files.exporter.cancel, files.picture, files.turntable]
        methods += [self.views.show_views, self.views.keep_view, self.views.forget_view]
        methods += [self.views.move_view, self.views.level, files.preview_path, self.save_as]
        methods += [] if store is None else [store.save]
        self._methods = {each.__name__: each for each in methods}
        self._changes = {each.__name__: each for each in changes}
        known = {} if self.readonly else {**self._changes, **self._methods}
        structs = [_struct_of(name, each) for name, each in known.items()]
        self.requests = [m.ViewRequest, m.Ping, m.Interrupt, *structs]
        """All that a page may send."""
        self.decoder = msgspec.json.Decoder(reduce(or_, self.requests))

    def act(self, client: int, message: msgspec.Struct, done: Callable[[], None]) -> m.Busy:
        """Ask for an action that a page wants; called in the server's thread.

        `done` is called when it is done, or has failed. Returns what to tell if it takes long.
        """
        name = str(type(message).__struct_config__.tag)
        values = msgspec.structs.asdict(message)

        def change(state: StudioState) -> StudioState | None:
            self.pictures.client = client
            try:
                if name in NEVER_CANCELLED:
                    return self._methods[name](**values)
                with self.session.worker.interruptible(client):
                    if name in self._changes:
                        return self._changes[name](state, **values)
                    return self._methods[name](**values)
            except Stopped:
                self.session.tell("Cancelled.")
                return None
            finally:
                done()

        key = None
        if name == "pick_extreme":
            key = name, values["by"]
        if name == "pick_at":
            key = name, values["place"], values["how"], self._look_number(client)
        if name in DRAGGED:
            whats = [k for k, v in values.items() if v is not None and k in ("strength", "form")]
            key = name, values.get("name"), str(values.get("names")), values.get("setting"), *whats

        def merge(state: StudioState) -> object:
            names = values.get("names") == [] and self._recolored(state)
            return (key[0], None, str(names), *key[3:]) if key and names else key

        with self.session.telling(client):
            self.session.do(change, merge=merge, kind=str(key or ""))
        return m.Busy(SLOW.get(name, "Working"), cancel=name not in NEVER_CANCELLED)

    def warm_up(self) -> None:
        """What takes long and is wanted soon, though not for the first picture."""
        for name in MATERIALS:
            self.gallery.add(Path(PREFIX + name))
        self.session.on_change.call()
        self.queue.warm_up()

    def pick_at(
        self,
        place: m.PicturePoint,
        how: m.How = "new",
        radius: m.Positive | None = None,
        reach: m.Positive | None = None,
        tolerance: m.Positive | None = None,
        size: PickSize = "object",
    ) -> StudioState:
        """Select the ball around a place, its colour, what looks alike there, or what ends there.

        The same place once more, of another size or reach, is picked in place of the last pick.
        """
        state, camera = self.session.state, self.pictures.camera()
        spot = place, how, self._look_number(self.pictures.client)
        known, picked, before = self._spot or (None, None, state)
        if known == spot and picked is state:
            state = before
        if radius is not None:
            found = picking.pick_ball(state, camera, place, radius, how)
        elif tolerance is not None:
            found = picking.pick_color(state, camera, place, tolerance, how)
        elif reach is not None:
            found = picking.pick_alike(state, camera, place, reach, how)
        else:
            found = picking.pick_surface(state, camera, place, size, how)
        self._spot = spot, found, state
        return found

    def _look_number(self, client: int) -> int | None:
        look = self.pictures.looks.get(client)
        return None if look is None else look.number

    def pick_drawn(
        self, shape: m.Shape, points: m.DrawnLine, how: m.How = "new", radius: m.Share = 0.02
    ) -> StudioState:
        camera = self.pictures.camera(MAP)
        inside = picking.region_of(shape, points, camera.size, radius)
        return picking.pick_drawn(self.session.state, camera, inside, how)

    def recolor(
        self,
        names: list[m.ShortText],
        setting: m.ShortText,
        value: float | m.ShortText | tuple[m.ShortText, ...] | None,
    ) -> Any:
        """Change a setting of objects' recolouring; `match` is the title of a style picture."""
        if setting == "match" and isinstance(value, str):
            value = str(self._style(value).path)
        state = before = self.session.state
        if not names:
            names = self._recolored(state)
            if state.selection is not None:
                state = picking.with_object_of_selection(state, RECOLORED)
        found = layers.recolor_objects(state, names, setting, value)
        if found is state:
            return before
        if before.selection is None or state is before:
            return found
        return layers.mask_layer(found, f"{names[0]}{RECOLOR}", before.selection.weights / 255)

    def _recolored(self, state: StudioState) -> list[str]:
        """The objects that a recolouring of the selection means, which is an object after it.

        Of a slider that is dragged, the first message made the object and picked it.
        """
        if state.selection is not None:
            return [picking.free_part_name(state, RECOLORED)]
        return [*state.picked]

    def remove_picked(self) -> StudioState:
        """Hide what is picked or selected, by a layer."""
        state = self.session.state
        require_picked(state)
        weights = picking.picked_weights(state) / 255
        what = ", ".join(state.picked) or "the selection"
        name = what if len(state.picked) == 1 else picking.free_part_name(state, "removed")
        found = layers.remove_rows(state, name, weights, f"Removed {what}")
        return replace(found, picked=(), selection=None)

    def repaint_layer(self, name: m.ShortText, settings: dict[str, Any]) -> None:
        """Paint a layer again in its own style, with other settings."""
        layers.refuse_locked(self.session.state, name)
        self.brushes.repaint(layers.find_layer(self.session.state.scene, name), settings)

    def copy_settings(self, name: m.ShortText, source: m.ShortText) -> StudioState | None:
        """Give a layer the strength, form and blend of another, and paint it with its settings."""
        state = self.session.state
        layers.refuse_locked(state, name)
        layer, other = (layers.find_layer(state.scene, each) for each in (name, source))
        settings = {k: v for k, v in other.settings.items() if k not in layers.OF_OBJECT}
        settings |= {k: v for k, v in layer.settings.items() if k in layers.OF_OBJECT}
        note = f"Gave {name} the settings of {source}"
        are_paint = {layer.kind, other.kind} == {"paint"}
        if not are_paint or settings == layer.settings:
            form = other.form if are_paint else None
            found = layers.adjust_layer(state, name, other.strength, form)
            shown = replace(layers.find_layer(found.scene, name), blend=other.blend)
            return layers.replace_layer(found, shown, note)
        own = {"intensity": other.strength, "form": other.form}
        style = layers.painted_style(replace(layer, settings=settings), **own)
        how = f", with the settings of {source}"
        self.queue.paint([name], style, layer_title(layer), True, blend=other.blend, how=how)
        return None

    def paint(
        self,
        style: m.ShortText,
        names: list[m.ShortText] | None = None,
        settings: dict[str, Any] | None = None,
        above: bool = False,
    ) -> None:
        """Paint objects or layers, by default what is picked, like the picture of a title.

        `above`: on new layers of these objects.
        """
        picture, state = self._style(style), self.session.state
        own = Style(picture.path, **(settings or {}))
        if names is None and state.selection is not None:
            self.queue.paint_selection(own, picture.title)
            return
        found = [*(state.picked if names is None else names)]
        for name in found:
            known = state.scene.layer(name)
            if known is not None and known.kind != "paint":
                raise StyleSplatError(f"{name} is no paint. Pick an object, and click the style.")
        require_objects(state.scene, [split_name(name)[0] for name in found])
        if above:
            found = [free_name(split_name(each)[0], state.scene.layer, "/") for each in found]
        for name in found:
            layers.refuse_locked(state, name)
        if not found:
            require_picked(replace(state, picked=()))
        for name in found:
            guides = self.brushes.guides_of(name)
            guided = Style(picture.path, **{**guides, **(settings or {})}) if guides else own
            self.queue.paint([name], guided, picture.title)

    def stop(self) -> None:
        self.previews.stop()
        self.queue.stop()

    def snapshot(self, name: m.ShortText) -> None:
        history = self.session.history
        history.keep_snapshot(name.strip() or f"Snapshot {len(history.snapshots) + 1}")
        self.session.on_change.call()

    def restore(self, number: int) -> StudioState:
        history = self.session.history
        kept = find_step(history.snapshots, number)
        return replace(history.state_of(kept), note=f"Restored {kept.note}")

    def forget_snapshot(self, number: int) -> None:
        snapshots = self.session.history.snapshots
        snapshots.remove(find_step(snapshots, number))
        self.session.on_change.call()

    def _picture_step(self, display: Display, pixels: ThumbnailPixels) -> None:
        """Keep a small copy of what a page shows, as the picture of the present step."""
        session = self.session
        step = session.history.step_now
        if not step.picture and session.preview is None and display is session.display:
            step.picture = jpeg(shrunk(pixels, STEP_SIDE))
            session.ask(session.on_change.call, kind="thumbnails", patient=True)

    def save_as(self, name: str) -> None:
        assert self._store is not None  # without it no page may ask
        before = self.session.folder
        self._store.save_as(name)
        if self._kept is not None:
            self._kept.move_along(before)
        self.gallery.move_along(self.session.folder)
        self.views.write()
        self.variants.move_along()

    def background(self, color: tuple[m.Share, m.Share, m.Share]) -> None:
        self.pictures.background = color
        self.pictures.refresh()

    def add_style(self, path: m.FileText) -> None:
        """Put a picture of this machine on the shelf, by its path."""
        if not self._is_local:
            raise StyleSplatError(
                "Paths are read only where the studio serves its own machine. Drop the file here."
            )
        title = self.gallery.add_file(path).title
        self.session.tell(f"Added {title}.")
        self.session.on_change.call()

    def forget_style(self, title: m.ShortText) -> None:
        """Take a picture that a page sent off the shelf."""
        picture, scene = self._style(title), self.session.state.scene
        if not picture.own:
            raise StyleSplatError(f"{title} was not sent by a page. Remove its file instead.")
        user = next((e for e in scene.layers for s in e.styles if s.path == picture.path), None)
        if user is not None:
            raise StyleSplatError(
                f"{user.object} has the style of {title}, which a new painting of it needs. Remove "
                "that layer first."
            )
        self.gallery.forget(title)
        self.session.on_change.call()

    def _style(self, title: str) -> StylePicture:
        found = self.gallery.pictures.get(title)
        if found is None:
            raise StyleSplatError(f"There is no picture {title} any more. Choose another one.")
        return found

    def hello(self, title: str) -> m.Hello:
        scene = self.session.state.scene
        taken = () if has_rendered_views(scene) else photo_views(scene, self._content.centre)
        return m.Hello(
            title=title,
            readonly=self.readonly,
            start={**self._start, "up": self.views.up.tolist()},
            photos=list(taken),
            settings=m.page_settings(StyleConfig),
            recolorings=m.page_settings(RecolorConfig),
            formats=FORMATS,
            extent=float(self._content.size.norm()),
            gaussians=len(scene.splats),
            max_bytes=MOST_BYTES,
        )

    def state_message(self) -> m.StateMessage:
        """All that the page shows, as far as it is known; called in the worker's thread."""
        session, state = self.session, self.session.state
        scene, history, box = state.scene, session.history, self._content
        if state.picked and all(session.masks.has(scene, name) for name in state.picked):
            box = session.masks.extent(scene, state.picked)
        selection, selected = None, state.selection
        if selected is not None:
            rows = selected.weights >= 128
            box = session.masks.extent_of(scene, (), rows)
            selection = selection_info(selected, int(rows.sum()), box)
        return m.StateMessage(
            objects=[object_info(session, self.thumbnails, each) for each in object_names(scene)],
            selection=selection,
            again=self._spot is not None and self._spot[1] is state,
            layers=[layer_info(state, each) for each in scene.layers],
            views=self.views.cards(),
            up=self.views.levelled,
            variants=self.variants.cards(),
            current=self.variants.current(scene),
            history=step_cards(self.gallery.files, history.steps),
            now=history.step_now.number,
            snapshots=step_cards(self.gallery.files, history.snapshots),
            styles=[*self.gallery.pictures.values()],
            previews=self.previews.urls,
            waiting=[(each.number, each.name, each.title) for each in self.queue.waiting],
            painting=session.painting,
            stopped=self.queue.stopped_note,
            undo=history.undo_note,
            redo=history.redo_note,
            note=state.note,
            unsaved=session.unsaved,
            folder=str(session.folder),
            command=self._command(),
            compared=self.variants.compared,
            box=(vector(box.low), vector(box.high)),
        )

    def _command(self) -> str:
        session, folder = self.session, self.session.folder
        if not session.saved.scene.layers or self.readonly:
            return ""
        output = folder.resolve().with_name(f"{folder.resolve().name}-painted")
        return shell_command("stylize", folder, "--recipe", folder / RECIPE, "-o", output)


def _struct_of(name: str, method: Callable[..., Any]) -> type[msgspec.Struct]:
    hints = get_type_hints(method, include_extras=True)
    fields = list[Any]()
    for each in inspect.signature(method).parameters.values():
        if each.name != "state":
            default = () if each.default is each.empty else (each.default,)
            fields.append((each.name, hints[each.name], *default))
    return msgspec.defstruct(name, fields, tag_field="do", tag=name, forbid_unknown_fields=True)
