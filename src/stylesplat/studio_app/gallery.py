"""The style pictures to paint with, and the files that pages fetch."""

import re
import shutil
import tempfile
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from urllib.parse import quote, urlsplit
from urllib.request import url2pathname

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.atomic import refuse_unwritable
from stylesplat.io.images import jpeg
from stylesplat.io.kinds import PHOTOS
from stylesplat.io.style_pictures import PREFIX, read_style
from stylesplat.progress import say
from stylesplat.scene.objects import free_name

MOST_BYTES = 40 * 2**20  # of an upload
GALLERY_MOST_PICTURES = 60  # in the gallery
GALLERY_SIDE = 480  # pixels along the longer side of what pages show
NO_NAME = re.compile(r"[^\w .-]|^\.+")
KEPT_STYLES = "studio-styles"  # in the scene's folder: the pictures that pages sent
SWATCHES = 6  # colours of a picture that are shown
GALLERY_PICTURE = "picture.jpg"  # the name of what is shown and not downloaded
DOWNLOADS = 2  # that are kept

ThumbnailPixels = UInt8[np.ndarray, "H W 3"]


class Files(dict[str, tuple[str, bytes]]):
    """Pictures and downloads by the digest of their content, which is part of their address."""

    def __init__(self) -> None:
        self._downloads = deque[str]()

    def add(self, content: bytes, name: str = GALLERY_PICTURE) -> str:
        """Keep a file; returns its address. Of downloads the latest are kept."""
        key = blake2b(content, digest_size=16).hexdigest()
        self[key] = name, content
        if name != GALLERY_PICTURE:
            self._downloads.append(key)
            if len(self._downloads) > DOWNLOADS:
                self.pop(self._downloads.popleft(), None)
        return f"/file/{key}/{quote(name)}"


@dataclass(frozen=True)
class StylePicture:
    title: str
    path: Path
    size: tuple[int, int]
    url: str
    colors: tuple[str, ...]
    """Its most frequent colours, as CSS has them."""
    own: bool = False
    """Whether a page sent it, so that a page may take it away."""


class Gallery:
    """Style pictures by title: those of a folder, materials, uploads."""

    def __init__(self, folder: Path | None = None, kept: Path | None = None) -> None:
        """`kept` is the folder for uploads, where those of earlier times are."""
        self.pictures, self.files, self.kept = dict[str, StylePicture](), Files(), kept
        self._uploads: tempfile.TemporaryDirectory[str] | None = None
        if folder is not None and not folder.is_dir():
            raise StyleSplatError(f"There is no folder {folder}. Pass one with style pictures.")
        for place in (folder, kept):
            is_there = place is not None and place.is_dir()
            for path in sorted(place.iterdir()) if place is not None and is_there else ():
                if path.suffix.lower() in PHOTOS and len(self.pictures) < GALLERY_MOST_PICTURES:
                    try:
                        self.add(path)
                    except StyleSplatError as error:
                        say(str(error))

    def add(self, path: Path) -> StylePicture:
        """Add the picture of a file, which stays where it is. None is added twice."""
        picture, name = read_style(path), style_title(path)
        height, width = picture.shape[:2]
        small = shrunk(to_uint8(picture).numpy(), GALLERY_SIDE)
        url, size = self.files.add(jpeg(small)), (width, height)
        for known in self.pictures.values():
            if (known.url, known.size) == (url, size):
                return known
        title = free_name(name, self.pictures.__contains__)
        own = path.parent in (self.kept, self._uploads and Path(self._uploads.name))
        found = StylePicture(title, path, size, url, frequent_colors(small), own)
        self.pictures[title] = found
        return found

    def upload(self, name: str, content: bytes) -> StylePicture:
        """Add a picture from a browser, which stays with the scene if its folder can be written."""
        if len(content) > MOST_BYTES:
            raise StyleSplatError(too_large(len(content)))
        self.refuse_full()
        path = self._place_for(name)
        path.write_bytes(content)
        try:
            found = self.add(path)
        except StyleSplatError as error:  # the sender knows no path of ours
            path.unlink()
            raise StyleSplatError(str(error).replace(str(path), path.stem)) from error
        if found.path != path:
            path.unlink()
        return found

    def add_file(self, text: str) -> StylePicture:
        """Add a picture of this machine, by its path or its `file:` address."""
        self.refuse_full()
        text = text.strip().strip("\"'")
        place = urlsplit(text)
        path = Path(url2pathname(place.path) if place.scheme == "file" else text).expanduser()
        if not path.is_absolute() or not path.is_file():
            raise StyleSplatError(
                f"There is no file {path} on the studio's machine. Give the whole path."
            )
        return self.add(path)

    def forget(self, title: str) -> None:
        """Take a picture that a page sent off the shelf, and delete it."""
        self.pictures.pop(title).path.unlink(missing_ok=True)

    def refuse_full(self) -> None:
        if len(self.pictures) >= GALLERY_MOST_PICTURES:
            raise StyleSplatError(
                f"The gallery holds {GALLERY_MOST_PICTURES} pictures and is full. Remove one."
            )

    def _place_for(self, name: str) -> Path:
        """A new path for an upload."""
        folder, own = self.kept, Path(name)
        with suppress(StyleSplatError, OSError):
            if folder is not None:
                refuse_unwritable(folder.parent)
                folder.mkdir(exist_ok=True)
        if folder is None or not folder.is_dir():
            if self._uploads is None:
                self._uploads = tempfile.TemporaryDirectory(prefix="stylesplat-uploads-")
            folder = Path(self._uploads.name)
        stem = NO_NAME.sub("", own.stem)[:40].strip() or "picture"
        suffix = own.suffix.lower() if own.suffix.lower() in PHOTOS else ".png"
        name = free_name(stem, lambda each: (folder / f"{each}{suffix}").exists())
        return folder / f"{name}{suffix}"

    def move_along(self, scene: Path) -> None:
        """Copy the uploads beside a scene that was saved elsewhere, for later studios."""
        before, self.kept = self.kept, scene / KEPT_STYLES
        if before is not None and before.is_dir():
            shutil.copytree(before, self.kept, dirs_exist_ok=True)

    def close(self) -> None:
        if self._uploads is not None:
            self._uploads.cleanup()


def style_title(path: Path | None) -> str:
    return "a picture" if path is None else path.stem.removeprefix(PREFIX).replace("_", " ")


def frequent_colors(pixels: ThumbnailPixels) -> tuple[str, ...]:
    """The colours that a picture has most of, each a mean of many alike (median cut)."""
    image = Image.fromarray(pixels).quantize(SWATCHES, Image.Quantize.MEDIANCUT)
    palette, counts = image.getpalette() or [], image.getcolors() or []
    rows = [row for _, row in sorted(counts, reverse=True) if isinstance(row, int)]
    return tuple("#" + bytes(palette[3 * row : 3 * row + 3]).hex() for row in rows)


def too_large(size: int) -> str:
    return f"The file has {size / 2**20:.0f} MB. Send {MOST_BYTES >> 20} MB at most."


def shrunk(pixels: UInt8[np.ndarray, "_ _ 3"], side: int) -> ThumbnailPixels:
    """A picture whose longer side has so many pixels at most."""
    image = Image.fromarray(pixels)
    image.thumbnail((side, side), Image.Resampling.LANCZOS)
    return np.array(image)
