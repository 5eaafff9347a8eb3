"""`sfm.json`: how the poses of a capture were found, and what became of each photo."""

from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from stylesplat.io.json_files import FilePath, read_json_as, write_json
from stylesplat.scene.one_line import counted, one_line

SFM_FILE = "sfm.json"
FORMAT = 1
MAX_PHOTOS = 1_000_000
Text = Annotated[str, Meta(max_length=4096, pattern=r"\A[^\x00-\x1f\x7f]*\Z")]  # in one line
Reasons = Annotated[dict[Text, Text], Meta(max_length=MAX_PHOTOS)]
Count = Annotated[int, Meta(ge=0, le=MAX_PHOTOS)]


class SfmRecord(msgspec.Struct, kw_only=True):
    """What `sfm.json` holds."""

    format: Annotated[int, Meta(ge=1, le=FORMAT)] = FORMAT
    source: FilePath
    """The folder of photos, or the video."""
    digest: Text
    """Of the names and sizes of its files."""
    given: Count
    """How many photos there were; of a video, how many frames were taken."""
    registered: Count
    """How many have a pose."""
    left_out: Reasons
    """By the user's own name of a photo why it was not tried."""
    unregistered: Reasons
    """By the user's own name of a photo that was tried why it has no pose."""
    origins: Reasons
    """By the name of a photo in the capture the user's own, where the two differ."""
    frame: dict[str, Any]
    """What the world's axes, origin and unit are."""
    settings: dict[str, Any]
    """What was asked for."""
    numbers: dict[str, Any]
    """What was measured, and how long it took."""
    libraries: dict[str, Text]
    """Versions."""

    def __repr__(self) -> str:
        found = f"{self.registered:,} of {counted(self.given, 'photo')} with a pose"
        return one_line(self, found, self.source)


def read_sfm(folder: Path) -> SfmRecord | None:
    """How the poses of a capture were found; None if they are not from `sfm`.

    Raises:
        StyleSplatError: If the file is damaged.
    """
    path = folder / SFM_FILE
    if not path.is_file():
        return None
    return read_json_as(path, SfmRecord, "Delete it, or pose the photos again.")


def write_sfm(record: SfmRecord, folder: Path) -> None:
    """Write `sfm.json` into a capture.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    write_json(msgspec.to_builtins(record), folder / SFM_FILE)
