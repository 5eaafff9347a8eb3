"""The style pictures to paint with, and the files that pages fetch."""

import re
import tempfile
from collections import deque
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from urllib.parse import quote

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.images import jpeg
from stylesplat.io.kinds import PHOTOS
from stylesplat.io.style_pictures import PREFIX, read_style
from stylesplat.progress import say

MOST_BYTES = 40 * 2**20  # of an upload
GALLERY_MOST_PICTURES = 60  # in the gallery
GALLERY_SIDE = 480  # pixels along the longer side of what pages show
NO_NAME = re.compile(r"[^\w .-]|^\.+")
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


class Gallery:
    """Style pictures by title: those of a folder, materials, uploads."""

    def __init__(self, folder: Path | None = None) -> None:
        self.pictures, self.files = dict[str, StylePicture](), Files()
        self._uploads: tempfile.TemporaryDirectory[str] | None = None
        if folder is not None and not folder.is_dir():
            raise StyleSplatError(f"There is no folder {folder}. Pass one with style pictures.")
        for path in sorted(folder.iterdir()) if folder is not None else ():
            if path.suffix.lower() in PHOTOS and len(self.pictures) < GALLERY_MOST_PICTURES:
                try:
                    self.add(path)
                except StyleSplatError as error:
                    say(str(error))

    def add(self, path: Path) -> StylePicture:
        picture, name = read_style(path), style_title(path)
        title, number = name, 2
        while title in self.pictures:
            title, number = f"{name} {number}", number + 1
        height, width = picture.shape[:2]
        url = self.files.add(jpeg(shrunk(to_uint8(picture).numpy(), GALLERY_SIDE)))
        self.pictures[title] = StylePicture(title, path, (width, height), url)
        return self.pictures[title]

    def upload(self, name: str, content: bytes) -> StylePicture:
        """Add a picture from a browser."""
        if len(content) > MOST_BYTES:
            raise StyleSplatError(too_large(len(content)))
        if len(self.pictures) >= GALLERY_MOST_PICTURES:
            raise StyleSplatError(
                f"The gallery holds {GALLERY_MOST_PICTURES} pictures and is full."
            )
        if self._uploads is None:
            self._uploads = tempfile.TemporaryDirectory(prefix="stylesplat-uploads-")
        folder = Path(tempfile.mkdtemp(dir=self._uploads.name))
        path = folder / f"{NO_NAME.sub('', Path(name).stem)[:40].strip() or 'picture'}.image"
        path.write_bytes(content)
        try:
            return self.add(path)
        except StyleSplatError as error:  # the sender knows no path of ours
            raise StyleSplatError(str(error).replace(str(path), path.stem)) from error

    def close(self) -> None:
        if self._uploads is not None:
            self._uploads.cleanup()


def style_title(path: Path | None) -> str:
    return "a picture" if path is None else path.stem.removeprefix(PREFIX).replace("_", " ")


def too_large(size: int) -> str:
    return f"The file has {size / 2**20:.0f} MB. Send {MOST_BYTES >> 20} MB at most."


def shrunk(pixels: UInt8[np.ndarray, "_ _ 3"], side: int) -> ThumbnailPixels:
    """A picture whose longer side has so many pixels at most."""
    image = Image.fromarray(pixels)
    image.thumbnail((side, side), Image.Resampling.LANCZOS)
    return np.array(image)
