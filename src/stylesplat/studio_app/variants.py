"""The paintings that were finished or stopped, and drafts, which stay beside the scene."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from weakref import WeakKeyDictionary

import msgspec
import numpy as np
import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_folder, refuse_unwritable
from stylesplat.io.files import reason
from stylesplat.io.json_yaml import read_json_as, write_json
from stylesplat.io.layers import STACK, read_layers, write_layers
from stylesplat.progress import say
from stylesplat.scene.layers import Layer, shown_like
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import IN_MEMORY, Selection
from stylesplat.studio_app.edits import (
    describe_settings,
    find_layer,
    refuse_locked,
    replace_layer,
)
from stylesplat.studio_app.gallery import Files
from stylesplat.studio_app.history import Selected, StudioState, hidden_rows, object_names
from stylesplat.studio_app.history_files import content_digest, tensor_bytes
from stylesplat.studio_app.messages import ShortText, Variant
from stylesplat.studio_app.selecting import with_object_of_selection
from stylesplat.studio_app.session import Display, Session
from stylesplat.studio_app.thumbnails import SELECTION, ObjectThumbnails

VARIANTS = "studio-variants"  # in the scene's folder: a folder each
ABOUT, PICTURE = "variant.json", "picture.jpg"
ROWS_FILE = "rows.npy"  # of a draft of a selection: its Gaussians, as bits
MOST_VARIANTS = 60  # the oldest without a star make room


class _About(msgspec.Struct):
    object: str
    title: str
    settings: str
    digest: str  # of the paint
    rows: str = ""  # the digest of the object's Gaussians, by which it is found once it is renamed
    name: ShortText = ""
    starred: bool = False
    draft: bool = False  # made by Try all; drafts are deleted before paintings


@dataclass(frozen=True, eq=False)
class _Kept:
    folder: Path
    about: _About
    url: str

    @property
    def id(self) -> str:
        return self.folder.name

    @property
    def title(self) -> str:
        return self.about.name or self.about.title


class Variants:
    """Their layers stay on the disk until one is shown."""

    def __init__(
        self, session: Session, files: Files, thumbnails: ObjectThumbnails, *, readonly: bool
    ) -> None:
        self._session, self._files, self._thumbnails = session, files, thumbnails
        self.compared: str | None = None
        """The id of the variant on the left of the handle."""
        self._reference: tuple[object, object, Display] | None = None
        self._elsewhere: TemporaryDirectory[str] | None = None
        """Where they are kept if the scene's folder cannot be written to."""
        self._digests = WeakKeyDictionary[Layer, str]()
        self._rows = dict[str, tuple[Tensor, str]]()  # digests of the masks of objects
        self._last: tuple[Path, Layer] | None = None
        self._kept = list[_Kept]()
        place = session.folder / VARIANTS
        for folder in sorted(place.iterdir()) if place.is_dir() and not readonly else ():
            if (folder / ABOUT).is_file():
                try:
                    about = read_json_as(folder / ABOUT, _About, "Delete its folder.")
                    self._kept.append(_Kept(folder, about, self._url(folder)))
                except (StyleSplatError, OSError) as error:
                    say(f"A variant is left out. {error}")

    def __len__(self) -> int:
        return len(self._kept)

    def cards(self) -> list[Variant]:
        return [
            Variant(e.id, self._object_of(e), e.title, e.about.settings, e.url, e.about.starred)
            for e in self._kept
        ]

    def current(self, scene: Scene) -> list[str]:
        """The ids of the variants that are shown."""
        shown = {self._digest(layer) for layer in scene.layers}
        return [each.id for each in self._kept if each.about.digest in shown]

    def keep_painted(self, name: str, title: str) -> None:
        """Keep a layer that was painted just now."""
        scene = self._session.state.scene
        self._keep(find_layer(scene, name), title, scene)

    def keep_draft(self, layer: Layer, title: str) -> bool:
        """Keep a draft that is not shown, in place of an earlier one with the same settings.

        Returns whether there is room for more.
        """
        state = self._session.state
        scene = state.scene.below(layer.name)
        if layer.object == SELECTION and state.selection is not None:
            scene = scene.with_object(SELECTION, SceneObject(state.selection.weights > 0))
        return self._keep(layer, title, scene.with_layer(layer), draft=True)

    def _keep(self, layer: Layer, title: str, scene: Scene, *, draft: bool = False) -> bool:
        """Keep a layer, with a picture of it in a scene. Returns False if that cannot be."""
        settings, digest = describe_settings(layer.settings), self._digest(layer)
        rows = self._rows_digest(layer.object, scene)
        about = _About(layer.object, title, settings, digest, rows, draft=draft)
        if draft and any(each.about.digest == digest for each in self._kept):
            return True
        if draft and len(self._kept) >= MOST_VARIANTS and not self._replaceable():
            self._session.tell(
                f"{MOST_VARIANTS} variants are kept, all of them paintings or marked: drafts are "
                "not kept. Delete some.",
                failure=True,
            )
            return False
        try:
            self._add(layer, about, scene)
        except (OSError, StyleSplatError) as error:
            why = reason(error).rstrip(".")
            self._session.tell(f"The variant is not kept: {why}.", failure=True)
            return False
        finally:
            self._session.on_change.call()
        return True

    def _add(self, layer: Layer, about: _About, scene: Scene) -> None:
        place, picture = self._place(), self._thumbnails.paint_picture(layer.object, scene)
        names = (*(each.name for each in place.iterdir()), *(each.id for each in self._kept))
        last = max((int(name) for name in names if name.isdecimal()), default=0)
        folder = place / f"{last + 1:04}"
        with atomic_folder(folder, overwrite=False, marker=STACK) as unfinished:
            write_layers([layer], unfinished)
            (unfinished / PICTURE).write_bytes(picture)
            write_json(msgspec.to_builtins(about), unfinished / ABOUT)
            if layer.object == SELECTION:
                mask = self._session.masks.of(scene, SELECTION)
                np.save(unfinished / ROWS_FILE, np.packbits(mask.cpu().numpy()))
        kept, drafts = _Kept(folder, about, self._url(folder)), self._replaceable()
        same = self._made_from(kept)
        earlier = [each for each in drafts if about.draft and self._made_from(each) == same]
        self._kept.append(kept)
        for each in earlier:
            self.delete_variant(each.id)
        if len(self._kept) > MOST_VARIANTS:
            plain = [each for each in self._kept[:-1] if not each.about.starred]
            if plain and not drafts:
                self._session.tell(f"{MOST_VARIANTS} variants are kept: the oldest one has gone.")
            if plain:
                self.delete_variant((drafts or plain)[0].id)

    def _made_from(self, each: _Kept) -> tuple[str, ...]:
        """What two variants have in common that are of one object or selection, painted alike."""
        name, about = self._object_of(each), each.about
        return name, about.rows if name == SELECTION else "", about.title, about.settings

    def _replaceable(self) -> list[_Kept]:
        """Drafts that nobody has starred or named, and that are neither shown nor compared."""
        used = {self.compared, *self.current(self._session.state.scene)}
        return [
            each
            for each in self._kept
            if each.about.draft
            and not (each.about.starred or each.about.name)
            and each.id not in used
        ]

    def layer(self, id: str) -> tuple[Layer, str]:
        """The layer of a variant, and what it is called."""
        each = self._item(id)
        if self._last is None or self._last[0] != each.folder:
            (layer,) = read_layers(each.folder, len(self._session.state.scene.base))
            self._last = each.folder, layer
        return replace(self._last[1], object=self._object_of(each)), each.title

    def use_variant(self, id: ShortText) -> StudioState:
        state = self._session.state
        refuse_locked(state, self.layer(id)[0].name)
        return self._shown(state, id)

    def compare_with(self, id: ShortText | None = None) -> None:
        """Show a variant on the left of the handle, or the scene before painting."""
        if id is not None:
            self._shown(self._session.state, id)
        self.compared = id
        self._session.on_change.call()

    def before(self) -> Display:
        """What lies on the left of the handle."""
        session, state = self._session, self._session.state
        key = self.compared, state.hidden
        known = self._reference
        if known is None or known[0] is not state.scene or known[1] != key:
            if self.compared is not None:
                other = self._shown(state, self.compared)
                display = Display(other.scene.splats, hidden_rows(other, session.masks))
            else:
                base, hidden = state.scene.base, hidden_rows(state, session.masks)
                display = Display(base, None if hidden is None else hidden[: len(base)])
            known = self._reference = state.scene, key, display
        return known[2]

    def _shown(self, state: StudioState, id: str) -> StudioState:
        layer, title = self.layer(id)
        rows = self._item(id).folder / ROWS_FILE
        if layer.object not in object_names(state.scene) and rows.is_file():
            state = _with_object_of(state, rows)
            layer = replace(layer, object=state.picked[0])
        shown = shown_like(layer, state.scene.layer(layer.name), len(state.scene.base))
        return replace_layer(state, shown, f"Switched {layer.object} to {title}")

    def star_variant(self, id: ShortText, starred: bool) -> None:
        self._change(id, starred=starred)

    def name_variant(self, id: ShortText, name: ShortText) -> None:
        self._change(id, name=name.strip())

    def delete_variant(self, id: ShortText) -> None:
        """Delete a variant for good; layers that show it stay."""
        each = self._item(id)
        if self.compared == id:
            self.compared = None
        shutil.rmtree(each.folder, ignore_errors=True)
        self._kept.remove(each)
        self._last = None  # another variant may get its number
        self._session.on_change.call()

    def move_along(self) -> None:
        """Copy them into the session's folder, which is another one by now."""
        place = self._session.folder / VARIANTS
        for number, each in enumerate(self._kept):
            if each.folder.parent != place:
                shutil.copytree(each.folder, place / each.folder.name)
                self._kept[number] = _Kept(place / each.folder.name, each.about, each.url)

    def close(self) -> None:
        if self._elsewhere is not None:
            self._elsewhere.cleanup()

    def _item(self, id: str) -> _Kept:
        found = next((each for each in self._kept if each.id == id), None)
        if found is None:
            raise StyleSplatError("This variant is not there any more. Choose another one.")
        return found

    def _change(self, id: str, **changes: object) -> None:
        each = self._item(id)
        about = msgspec.structs.replace(each.about, **changes)
        write_json(msgspec.to_builtins(about), each.folder / ABOUT)
        self._kept[self._kept.index(each)] = _Kept(each.folder, about, each.url)
        self._session.on_change.call()

    def _object_of(self, each: _Kept) -> str:
        """What the object of a variant is called now."""
        scene, masks = self._session.state.scene, self._session.masks
        names = [name for name in object_names(scene) if masks.has(scene, name)]
        if each.about.object in names:
            return each.about.object
        same = (name for name in names if self._rows_digest(name, scene) == each.about.rows)
        return next(same, each.about.object)

    def _rows_digest(self, name: str, scene: Scene) -> str:
        mask = self._session.masks.of(scene, name)
        known = self._rows.get(name)
        if known is None or known[0] is not mask:
            known = self._rows[name] = mask, content_digest(tensor_bytes(mask))
        return known[1]

    def _digest(self, layer: Layer) -> str:
        if layer not in self._digests:
            colors = layer.sh0, layer.surfels.sh0
            self._digests[layer] = content_digest(*map(tensor_bytes, colors))
        return self._digests[layer]

    def _url(self, folder: Path) -> str:
        content = (folder / PICTURE).read_bytes()
        return self._files.add(content) if content else ""

    def _place(self) -> Path:
        try:
            refuse_unwritable(self._session.folder)
            place = self._session.folder / VARIANTS
        except StyleSplatError as error:
            if self._elsewhere is None:
                self._elsewhere = TemporaryDirectory(prefix="stylesplat-variants-")
                self._session.tell(f"Variants last as long as the studio runs. {error}")
            place = Path(self._elsewhere.name)
        place.mkdir(exist_ok=True)
        return place


def _with_object_of(state: StudioState, path: Path) -> StudioState:
    """The state with an object of the selection that a draft was of, as painting makes it."""
    count = len(state.scene.base)
    rows = torch.from_numpy(np.unpackbits(np.load(path), count=count).astype(bool))
    selected = state.selection
    if selected is None or not torch.equal(selected.weights.cpu() > 0, rows):
        rows = rows.to(state.scene.base.device)
        selected = Selected(rows.to(torch.uint8) * 255, Selection(rows=IN_MEMORY))
    return with_object_of_selection(replace(state, selection=selected), "painted")
