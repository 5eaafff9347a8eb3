"""The paintings that were finished or stopped, which stay beside the scene."""

import shutil
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from tempfile import TemporaryDirectory
from weakref import WeakKeyDictionary

import msgspec

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_folder, refuse_unwritable
from stylesplat.io.json_yaml import read_json_as, write_json
from stylesplat.io.layers import STACK, read_layers, write_layers
from stylesplat.progress import say
from stylesplat.scene.layers import Layer
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.gallery import Files
from stylesplat.studio_app.messages import ShortText, Variant
from stylesplat.studio_app.session import Session

VARIANTS = "studio-variants"  # in the scene's folder: a folder each
ABOUT, PICTURE = "variant.json", "picture.jpg"
MOST_VARIANTS = 60  # the oldest without a star make room


class _About(msgspec.Struct):
    object: str
    title: str
    settings: str
    digest: str  # of the paint
    name: ShortText = ""
    starred: bool = False


@dataclass(frozen=True, eq=False)
class _Kept:
    folder: Path
    about: _About
    url: str


class Variants:
    """Their layers stay on the disk until one is shown."""

    def __init__(self, session: Session, files: Files, *, readonly: bool) -> None:
        self._session, self._files = session, files
        self._elsewhere: TemporaryDirectory[str] | None = None
        """Where they are kept if the scene's folder cannot be written to."""
        self._digests = WeakKeyDictionary[Layer, str]()
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
            Variant(a.object, a.name or a.title, a.settings, each.url, a.starred)
            for each in self._kept
            for a in (each.about,)
        ]

    def current(self, scene: Scene) -> list[int]:
        """The variants that are shown."""
        shown = {self._digest(layer) for layer in scene.layers}
        return [number for number, each in enumerate(self._kept) if each.about.digest in shown]

    def add(self, layer: Layer, title: str, settings: str, picture: bytes) -> None:
        about = _About(layer.object, title, settings, self._digest(layer))
        place = self._place()
        last = max((int(e.name) for e in place.iterdir() if e.name.isdecimal()), default=0)
        folder = place / f"{last + 1:04}"
        with atomic_folder(folder, overwrite=False, marker=STACK) as draft:
            write_layers([layer], draft)
            (draft / PICTURE).write_bytes(picture)
            write_json(msgspec.to_builtins(about), draft / ABOUT)
        self._kept.append(_Kept(folder, about, self._url(folder)))
        if len(self._kept) > MOST_VARIANTS:
            plain = [n for n, each in enumerate(self._kept[:-1]) if not each.about.starred]
            if plain:
                self._session.tell(f"{MOST_VARIANTS} variants are kept: the oldest one has gone.")
                self.delete_variant(plain[0])

    def layer(self, number: int) -> tuple[Layer, str]:
        """The layer of a variant, and what it is called."""
        each = self._item(number)
        if self._last is None or self._last[0] != each.folder:
            (layer,) = read_layers(each.folder, len(self._session.state.scene.base))
            self._last = each.folder, layer
        return self._last[1], each.about.name or each.about.title

    def star_variant(self, number: int, starred: bool) -> None:
        self._change(number, starred=starred)

    def name_variant(self, number: int, name: ShortText) -> None:
        self._change(number, name=name.strip())

    def delete_variant(self, number: int, url: str | None = None) -> None:
        """Delete a variant for good, the one of this picture; layers that show it stay."""
        each = self._item(number)
        if url not in (None, each.url):
            raise StyleSplatError("The variants are others by now. Choose it again.")
        shutil.rmtree(each.folder, ignore_errors=True)
        self._kept.remove(each)
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

    def _item(self, number: int) -> _Kept:
        if not 0 <= number < len(self._kept):
            raise StyleSplatError("This variant is not there any more. Reload the page.")
        return self._kept[number]

    def _change(self, number: int, **changes: object) -> None:
        each = self._item(number)
        about = msgspec.structs.replace(each.about, **changes)
        write_json(msgspec.to_builtins(about), each.folder / ABOUT)
        self._kept[number] = _Kept(each.folder, about, each.url)
        self._session.on_change.call()

    def _digest(self, layer: Layer) -> str:
        if layer not in self._digests:
            found = blake2b(digest_size=16)
            for colors in (layer.sh0, layer.surfels.sh0):
                found.update(colors.detach().cpu().contiguous().numpy().tobytes())
            self._digests[layer] = found.hexdigest()
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
