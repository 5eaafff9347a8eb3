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
    format: Annotated[int, Meta(ge=1, le=FORMAT)] = FORMAT
    source: FilePath
    """The folder of photos, or the video."""
    digest: Text
    """Hash of the names and sizes of its files."""
    given: Count
    """Number of photos in the source, or of frames taken from the video."""
    registered: Count
    left_out: Reasons
    """Why a photo was not tried, by the user's name of it."""
    unregistered: Reasons
    """Why a photo that was tried has no pose, by the user's name of it."""
    origins: Reasons
    """The user's name of a photo by its name in the capture, where the two differ."""
    frame: dict[str, Any]
    """The world's axes, origin and unit."""
    settings: dict[str, Any]
    numbers: dict[str, Any]
    libraries: dict[str, Text]

    def __repr__(self) -> str:
        found = f"{self.registered:,} of {counted(self.given, 'photo')} with a pose"
        return one_line(self, found, self.source)


def read_sfm(folder: Path) -> SfmRecord | None:
    """Read how the poses of a capture were found; None if they are not from `sfm`."""
    path = folder / SFM_FILE
    if not path.is_file():
        return None
    return read_json_as(path, SfmRecord, "Delete it, or pose the photos again.")


def write_sfm(record: SfmRecord, folder: Path) -> None:
    write_json(msgspec.to_builtins(record), folder / SFM_FILE)
