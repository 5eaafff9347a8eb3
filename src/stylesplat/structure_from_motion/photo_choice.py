"""Which photos of a folder are fit for structure from motion."""

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.captures.photos import SmallPhoto, plain_suffix, read_small
from stylesplat.io.files import reason
from stylesplat.progress import track
from stylesplat.structure_from_motion.backgrounds import missing_background
from stylesplat.structure_from_motion.duplicates import near_duplicates
from stylesplat.structure_from_motion.exif import taken_at
from stylesplat.structure_from_motion.ordering import is_series, neighbours_overlap
from stylesplat.structure_from_motion.photo_folder import Found, written_names
from stylesplat.structure_from_motion.prepared import LEAST, Prepared
from stylesplat.structure_from_motion.sharpness import (
    ALL_BLURRED,
    BLURRED,
    SIDE,
    relative,
    sharpness,
)

THREADS = 2  # of decoders, which need 100 MB for a photo of 12 megapixels
CUT_OUTS = 0.5  # of all photos that are cut out: more is no mistake
MOST_NAMED = 3  # reasons that a message gives


@dataclass(frozen=True)
class Look:
    """What is known of a photo once it has been looked at."""

    name: str
    """Its path in the user's folder."""
    small: SmallPhoto = field(repr=False)
    """How it looks."""
    sharp: float
    """As `sharpness` measures it."""
    taken: str | None
    """When it was taken."""
    suffix: str
    """Of the file that will be written."""


def choose_photos(source: Path, found: Found) -> Prepared:
    """Look at all photos of a folder and leave out those that are unreadable, blurred or repeats.

    Args:
        source: The folder.
        found: What it holds.

    Raises:
        StyleSplatError: If fewer than 3 photos are left, most have no background, or all are
            blurred.
    """
    left_out = {**found.left_out, **dict.fromkeys(found.videos, "a video among photos")}
    looks = _look_at_all(source, found.photos, left_out)
    looks = _without_cut_outs(source, looks, left_out)
    timed = all(look.taken for look in looks)
    series = is_series([look.name for look in looks]) if looks else False
    if timed and not series:
        looks = sorted(looks, key=lambda look: look.taken or "")
    relatives = dict(zip([k.name for k in looks], relative([k.sharp for k in looks]), strict=True))
    kept = _without_blurred(source, looks, relatives, left_out)
    kept = _without_repeats(kept, relatives, left_out)
    if len(kept) < LEAST:
        raise too_few(source, len(kept), "photos", left_out)
    names = written_names(tuple(k.name for k in kept), tuple(k.suffix for k in kept))
    return Prepared(
        names=names,
        ordered=(series or timed) and neighbours_overlap([look.small.grey for look in kept]),
        origins={name: look.name for name, look in zip(names, kept, strict=True)},
        sharpness={name: relatives[k.name] for name, k in zip(names, kept, strict=True)},
        left_out=left_out,
    )


def too_few(source: Path, count: int, what: str, left_out: Mapping[str, str]) -> StyleSplatError:
    """What to tell the user who has not enough photos.

    Args:
        source: Where they are.
        count: How many can be used.
        what: What they are.
        left_out: Others by name, and why.
    """
    reasons = Counter(map(_kind, left_out.values())).most_common(MOST_NAMED)
    others = "".join(f"; {number} left out: {text}" for text, number in reasons)
    first = next((f" ({brief(name)}: {text})" for name, text in left_out.items()), "")
    return StyleSplatError(
        f"{source} has {count or 'no'} {what} that can be used{others}{first}. "
        f"Give {LEAST} at least, better 30 or more, that overlap."
    )


def _look_at_all(source: Path, names: Sequence[str], left_out: dict[str, str]) -> list[Look]:
    def look(name: str) -> Look | str:
        try:
            return _look(source, name)
        except StyleSplatError as error:
            return f"no readable picture: {reason(_cause(error))}"

    # Python's own filters are of the process: those that threads set would get mixed up
    with warnings.catch_warnings(action="ignore"), ThreadPoolExecutor(THREADS) as pool:
        try:
            looks = [
                *track(pool.map(look, names), "looking at photos", total=len(names), unit="photo")
            ]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    left_out.update({n: k for n, k in zip(names, looks, strict=True) if isinstance(k, str)})
    return [look for look in looks if isinstance(look, Look)]


def _look(source: Path, name: str) -> Look:
    path = source / name
    small = read_small(path, SIDE)
    suffix = plain_suffix(path) or ".jpg"
    return Look(name, small, sharpness(small.grey), taken_at(path), suffix)


def _kind(text: str) -> str:
    """A reason without what differs from photo to photo."""
    return text.partition(":")[0].partition(" as ")[0]


def _cause(error: StyleSplatError) -> Exception:
    return error.__cause__ if isinstance(error.__cause__, Exception) else error


def _without_cut_outs(source: Path, looks: list[Look], left_out: dict[str, str]) -> list[Look]:
    found = {look.name: missing_background(look.small) for look in looks}
    cut = {name: f"its background is {kind}" for name, kind in found.items() if kind}
    if len(cut) > CUT_OUTS * len(looks):
        kind = Counter(found[name] for name in cut).most_common(1)[0][0]
        raise StyleSplatError(
            f"{len(cut)} of {len(looks)} photos of {source} have no background: it is {kind}. "
            "The background is needed to find the cameras; give the photos as they were taken."
        )
    left_out.update(cut)
    return [look for look in looks if look.name not in left_out]


def _without_blurred(
    source: Path, looks: list[Look], relatives: Mapping[str, float], left_out: dict[str, str]
) -> list[Look]:
    if len(looks) >= LEAST and np.median([look.sharp for look in looks]) < ALL_BLURRED:
        raise StyleSplatError(
            f"The photos of {source} are all blurred. Hold the camera still for each photo, in "
            "more light, and let it focus."
        )
    blurred = [look.name for look in looks if relatives[look.name] < BLURRED]
    left_out.update(dict.fromkeys(blurred, "blurred"))
    return [look for look in looks if look.name not in left_out]


def _without_repeats(
    looks: list[Look], relatives: Mapping[str, float], left_out: dict[str, str]
) -> list[Look]:
    worth = [(float(np.prod(k.small.size)), relatives[k.name]) for k in looks]
    repeats = near_duplicates([look.small.grey for look in looks], worth)
    for photo, other in sorted(repeats.items()):
        left_out[looks[photo].name] = f"nearly the same as {looks[other].name}"
    return [look for look in looks if look.name not in left_out]
