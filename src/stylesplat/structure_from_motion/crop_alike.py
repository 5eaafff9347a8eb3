"""Photos from a camera that stood still, each of which was cropped in its own way.

Programs for photos of products and finds crop each photo around the object. Then the room shifts
from photo to photo, and the middle of the lens lies elsewhere in each. What all photos show of the
room is what one camera took.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import resolve_within
from stylesplat.io.images import image_sizes, read_image, write_image
from stylesplat.structure_from_motion.object_features import (
    STILL_MATCH,
    Matches,
    common_shift,
    still_matches,
)
from stylesplat.structure_from_motion.photos import color_profile, lens_exif, map_photos

REWEIGHTED = 20  # times, after which the sum of absolute deviations hardly changes
MIN_LEFT = 0.5  # of the smallest photo's sides: if less is common, the photos are no crops of one


def find_offsets(
    places: Sequence[Float[np.ndarray, "_ 2"]], matches: Matches, sides: Sequence[int]
) -> Float[np.ndarray, "P 2"]:
    """Where each photo shows the still room, in pixels from the typical place; 0 if all agree.

    The shifts between pairs of photos decide, by the least sum of absolute deviations: a pair may
    be wrong.
    """
    pairs, shifts = list[tuple[int, int]](), list[Float[np.ndarray, "2"]]()
    for pair, rows in matches.items():
        here, there = (places[photo][rows[:, side]] for side, photo in enumerate(pair))
        shift = common_shift(here, there, sides[pair[0]])
        if still_matches(here, there, shift, sides[pair[0]]).any():
            pairs.append(pair)
            shifts.append(shift)
    nowhere = np.zeros((len(places), 2))
    if not pairs:
        return nowhere
    ends, found = np.array(pairs), np.array(shifts)
    links = np.zeros((len(pairs), len(places)))
    links[np.arange(len(pairs)), ends[:, 1]], links[np.arange(len(pairs)), ends[:, 0]] = 1, -1
    weights, offsets = np.ones(len(pairs)), nowhere
    for _ in range(REWEIGHTED):
        scaled = links * weights[:, None]
        offsets = np.linalg.lstsq(links.T @ scaled, scaled.T @ found, rcond=None)[0]
        weights = 1 / np.linalg.norm(links @ offsets - found, axis=1).clip(min=1)
    linked = np.unique(ends)
    offsets -= np.median(offsets[linked], axis=0)
    offsets[np.setdiff1d(np.arange(len(places)), linked)] = 0
    return offsets if np.abs(offsets).max() > STILL_MATCH * min(sides) else nowhere


def crop_alike(
    photos: Path, names: Sequence[str], offsets: Float[np.ndarray, "P 2"], folder: Path
) -> tuple[Int[np.ndarray, "P 2"], tuple[int, int]]:
    """Write of each photo what all show of the room; return where it begins there, and its size."""
    sizes = np.array([image_sizes(resolve_within(photos, name))[1] for name in names])
    begin, end = (-offsets).max(axis=0), (sizes - offsets).min(axis=0)
    width, height = (int(each) - 1 for each in end - begin)  # corners are rounded
    if (np.array([width, height]) < MIN_LEFT * sizes.min(axis=0)).any():
        raise StyleSplatError("The photos show too little of the same room.")
    corners = (begin + offsets).round().astype(int)

    def write(name: str, corner: Int[np.ndarray, "2"]) -> None:
        source, target = resolve_within(photos, name), resolve_within(folder, name)
        if target.exists() and image_sizes(target)[1] == (width, height):
            return  # an earlier call wrote it: features that were found in it stay valid
        x, y = corner
        write_image(
            read_image(source)[y : y + height, x : x + width].contiguous(),
            target,
            exif=lens_exif(source),
            icc_profile=color_profile(source),
        )

    map_photos(lambda each: write(*each), [*zip(names, corners, strict=True)], "cropping photos")
    return corners, (width, height)
