"""What the readers of COLMAP and transforms.json have in common."""

import os
import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath

from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief, some
from stylesplat.io.captures.lens import Lens
from stylesplat.io.json_files import MAX_NAME
from stylesplat.progress import say

# Bytes of a file's or folder's name: systems take 255, and a draft's name has 14 more
MAX_PART = 240
CONTROL = re.compile(r"[\x00-\x1f\x7f]")


@dataclass(frozen=True)
class PosedFiles:
    """Posed photos as a capture's files describe them; no photo has been opened.

    Label maps and views are written under the photos' names, so a name that leaves its folder, that
    no file can have or that occurs twice is a StyleSplatError.
    """

    names: tuple[str, ...]
    """Of the photos, within their common folder."""
    paths: tuple[Path, ...]
    lenses: tuple[Lens | None, ...]
    """None where the lens depends on a photo that does not exist."""
    viewmats: Float[Tensor, "C 4 4"]
    """World to camera, OpenCV axes, as read: 64 bits, not checked."""
    points: Float[Tensor, "M 3"] | None
    point_colors: UInt8[Tensor, "M 3"] | None

    def __post_init__(self) -> None:
        for name in self.names:
            check_path(name)
            if _leaves(name):
                raise StyleSplatError(
                    f"The photo {brief(name)!r} has a name that leaves the folder of the photos. "
                    "Pose the photos again, under names without '..' that are not absolute."
                )
        for name, count in Counter(map(PurePosixPath, self.names)).items():
            if count > 1:
                raise StyleSplatError(
                    f"The photo {brief(str(name))!r} is posed {count} times. Keep one of its poses."
                )


def drop_missing(posed: PosedFiles, folder: Path) -> PosedFiles:
    """Leave out photos whose files do not exist, with a message; more than half are an error."""
    there = [os.path.lexists(path) for path in posed.paths]  # unlike Path's, it takes any name
    missing = [name for name, found in zip(posed.names, there, strict=True) if not found]
    if not missing:
        return posed
    count = len(posed.names)
    if 2 * len(missing) > count:
        raise StyleSplatError(
            f"Only {count - len(missing)} of the {count} photos that have poses in {folder} are "
            f"there. Missing: {some(missing)}. Put them back, or pose the photos again."
        )
    say(
        f"Missing, so left out: {some(missing)} "
        f"({len(missing)} of the {count} photos that have poses in {folder})."
    )
    rows = [row for row, found in enumerate(there) if found]
    return replace(
        posed,
        names=tuple(posed.names[row] for row in rows),
        paths=tuple(posed.paths[row] for row in rows),
        lenses=tuple(posed.lenses[row] for row in rows),
        viewmats=posed.viewmats[rows],
    )


def check_path(text: str) -> None:
    """Raise a StyleSplatError for a path that no photo can have."""
    encoded = text.encode(errors="surrogatepass")
    if len(encoded) > MAX_NAME or max(map(len, encoded.split(b"/"))) > MAX_PART:
        fault = "its name is too long"
    elif CONTROL.search(text):
        fault = "its name has control characters"
    elif any("\ud800" <= letter <= "\udfff" for letter in text):
        fault = "its name is not UTF-8"
    else:
        return
    raise StyleSplatError(
        f"The photo {brief(text)!r} cannot be a file: {fault}. Rename it, and pose again."
    )


def _leaves(name: str) -> bool:
    """Whether a name leaves its folder, or names the folder itself, on any system."""
    windows = PureWindowsPath(name)
    return bool(
        windows.drive or windows.root or ".." in windows.parts or not PurePosixPath(name).name
    )
