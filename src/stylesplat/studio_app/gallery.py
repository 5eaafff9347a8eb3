"""The style pictures that there are to paint with: of a folder, and those that were uploaded."""

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.kinds import PHOTOS
from stylesplat.progress import say
from stylesplat.studio_app.thumbnails import Thumbnail, picture_thumbnail
from stylesplat.stylization.style_image import read_style

MOST_BYTES = 40 * 2**20  # of an upload
MOST_PICTURES = 60  # in the gallery
NO_NAME = re.compile(r"[^\w .-]|^\.+")


@dataclass(frozen=True)
class Exhibit:
    """A style picture."""

    title: str
    """What it is called; no two are alike."""
    path: Path
    """Its file."""
    size: tuple[int, int]
    """Its width and height in pixels."""
    thumbnail: Thumbnail
    """Its middle."""


class Gallery:
    """Pictures by title."""

    def __init__(self, folder: Path | None = None) -> None:
        """Read the pictures of a folder; what is unfit is told.

        Raises:
            StyleSplatError: If there is no such folder.
        """
        self._exhibits = dict[str, Exhibit]()
        self._uploads: tempfile.TemporaryDirectory[str] | None = None
        if folder is None:
            return
        if not folder.is_dir():
            raise StyleSplatError(f"There is no folder {folder}. Pass one with style pictures.")
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in PHOTOS and len(self) < MOST_PICTURES:
                try:
                    self.add(path)
                except StyleSplatError as error:
                    say(str(error))

    def __len__(self) -> int:
        return len(self._exhibits)

    @property
    def exhibits(self) -> list[Exhibit]:
        """All, in order."""
        return [*self._exhibits.values()]

    def __getitem__(self, title: str) -> Exhibit:
        return self._exhibits[title]

    def add(self, path: Path) -> Exhibit:
        """Hang one more.

        Raises:
            StyleSplatError: If it is no picture to take a style from.
        """
        picture = read_style(path)
        title, number = path.stem, 2
        while title in self._exhibits:
            title, number = f"{path.stem} {number}", number + 1
        height, width = picture.shape[:2]
        exhibit = Exhibit(title, path, (width, height), picture_thumbnail(picture))
        self._exhibits[title] = exhibit
        return exhibit

    def upload(self, name: str, content: bytes) -> Exhibit:
        """Hang one that came from a browser.

        Args:
            name: What it is called there; only its letters and digits are used.
            content: Of the file.

        Raises:
            StyleSplatError: If it is too large, or no picture to take a style from.
        """
        if len(content) > MOST_BYTES:
            raise StyleSplatError(too_large(len(content)))
        if len(self) >= MOST_PICTURES:
            raise StyleSplatError(f"The gallery holds {MOST_PICTURES} pictures and is full.")
        if self._uploads is None:
            self._uploads = tempfile.TemporaryDirectory(prefix="stylesplat-uploads-")
        folder = Path(tempfile.mkdtemp(dir=self._uploads.name))
        path = folder / f"{NO_NAME.sub('', Path(name).stem)[:40].strip() or 'picture'}.image"
        path.write_bytes(content)
        try:
            return self.add(path)
        except StyleSplatError as error:  # whoever sent it knows no path of ours
            raise StyleSplatError(str(error).replace(str(path), path.stem)) from error

    def close(self) -> None:
        """Remove what was uploaded."""
        if self._uploads is not None:
            self._uploads.cleanup()


def too_large(size: int) -> str:
    """What is said of a file of so many bytes."""
    return f"The file has {size / 2**20:.0f} MB. Send {MOST_BYTES >> 20} MB at most."
