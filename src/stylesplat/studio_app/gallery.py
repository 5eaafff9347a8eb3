"""The style pictures to paint with: those of a folder, and uploads."""

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.kinds import PHOTOS
from stylesplat.progress import say
from stylesplat.studio_app.thumbnails import jpeg, shrunk
from stylesplat.stylization.style_image import read_style

MOST_BYTES = 40 * 2**20  # of an upload
MOST_PICTURES = 60  # in the gallery
SMALL, LARGE = 240, 720  # pixels along the longer side
NO_NAME = re.compile(r"[^\w .-]|^\.+")


@dataclass(frozen=True)
class StylePicture:
    title: str
    """Differs from all others."""
    path: Path
    size: tuple[int, int]
    """Width and height in pixels."""
    thumbnail: bytes
    """A JPEG."""
    large: bytes
    """A larger JPEG."""


class Gallery:
    """Style pictures by title."""

    def __init__(self, folder: Path | None = None) -> None:
        self.pictures = dict[str, StylePicture]()
        self._uploads: tempfile.TemporaryDirectory[str] | None = None
        if folder is None:
            return
        if not folder.is_dir():
            raise StyleSplatError(f"There is no folder {folder}. Pass one with style pictures.")
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in PHOTOS and len(self.pictures) < MOST_PICTURES:
                try:
                    self.add(path)
                except StyleSplatError as error:
                    say(str(error))

    def add(self, path: Path) -> StylePicture:
        picture = read_style(path)
        stem = path.stem.replace("_", " ")
        title, number = stem, 2
        while title in self.pictures:
            title, number = f"{stem} {number}", number + 1
        height, width = picture.shape[:2]
        small, large = (jpeg(shrunk(picture, side)) for side in (SMALL, LARGE))
        self.pictures[title] = StylePicture(title, path, (width, height), small, large)
        return self.pictures[title]

    def upload(self, name: str, content: bytes) -> StylePicture:
        """Add a picture from a browser."""
        if len(content) > MOST_BYTES:
            raise StyleSplatError(too_large(len(content)))
        if len(self.pictures) >= MOST_PICTURES:
            raise StyleSplatError(f"The gallery holds {MOST_PICTURES} pictures and is full.")
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
        """Remove the uploads."""
        if self._uploads is not None:
            self._uploads.cleanup()


def too_large(size: int) -> str:
    return f"The file has {size / 2**20:.0f} MB. Send {MOST_BYTES >> 20} MB at most."
