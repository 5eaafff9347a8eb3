"""The features of one object: the others of a photo are ignored when poses are found.

An object on a turntable and the still room behind it move in two ways. Poses of one of them are
wrong for the other, and poses of both together are wrong for both.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Integer
from PIL import Image
from scipy.spatial import KDTree

from stylesplat.errors import StyleSplatError, join_names
from stylesplat.io.captures.photos import PHOTO_OPAQUE, same_shape
from stylesplat.io.files import resolve_within
from stylesplat.io.images import decode, image_sizes
from stylesplat.photo_libraries import cv2, pycolmap
from stylesplat.structure_from_motion.workspace import Workspace, mask_file, numbered_files

STILL_MATCH, MOVED_MATCH = 0.003, 0.01  # displacements of matches, in longer sides of the photo
MIN_MATCHES = 15  # of each motion, COLMAP's least number for a geometry of two photos
# Deviation of the still matches, in longer sides: the centre of an orbit has less
FEATURE_SPREAD = 0.1
MIN_FITTING = 0.5  # share of the moving matches that fit one geometry
FEATURE_MAX_PAIRS = 300  # that are looked at
FEATURE_NEIGHBOURS = 5  # features around a place that decide what it shows
FEATURE_REACH = 0.04  # of an object beyond its features, in longer sides
GRID = 4  # pixels
FEATURE_PLAIN = 10  # grey levels by which plain surroundings vary in JPEG files
OUTLINE = 5  # pixels: an outline's features slide over the object

PhotoBox = tuple[float, float, float, float]
MaskReaders = Mapping[str, Callable[[], Bool[np.ndarray, "_ _"]]]
"""By photo."""
Matches = Mapping[tuple[int, int], Integer[np.ndarray, "M 2"]]
MatchedFeatures = tuple[list[Float[np.ndarray, "_ 2"]], Matches]
"""The places of each photo's features, and their matches."""


def read_matches(workspace: Workspace) -> MatchedFeatures:
    """The features of each photo, and the matches of each pair by row, wrong ones included."""
    with workspace.open_database() as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        places = [
            database.read_keypoints(ids[file])[:, :2] if file in ids else np.zeros((0, 2))
            for file in workspace.files
        ]
        keys, found = database.read_all_matches()
    row_of = {id: workspace.files.index(file) for file, id in ids.items()}
    pairs = [tuple(row_of[i] for i in pycolmap.pair_id_to_image_pair(key)) for key in keys]
    return places, {(a, b): each for (a, b), each in zip(pairs, found, strict=True) if len(each)}


@dataclass(frozen=True)
class TwoMotions:
    """A room that stays, and what moves before it."""

    share: float
    """Of the pairs of photos that show both."""
    photo: int
    """The one that shows most of what moves."""
    box: PhotoBox
    """Around what moves there."""


NO_MOTION = TwoMotions(0.0, 0, (0.0, 0.0, 0.0, 0.0))


def find_two_motions(
    places: Sequence[Float[np.ndarray, "_ 2"]], matches: Matches, sides: Sequence[int]
) -> TwoMotions:
    """Look for pairs in which much stays at its pixel while the rest moves as one.

    Where photos were cropped in their own ways, what stays shifts by the same pixels.
    """
    pairs = [pair for pair, each in matches.items() if len(each) >= 2 * MIN_MATCHES]
    pairs = pairs[:: -(-len(pairs) // FEATURE_MAX_PAIRS) or 1]
    moving = {pair: _moving_as_one(places, matches[pair], pair, sides) for pair in pairs}
    (photo, _), most = max(moving.items(), key=lambda each: len(each[1]), default=((0, 0), []))
    if not len(most):
        return NO_MOTION
    low, high = (np.quantile(most, share, axis=0).round().tolist() for share in (0.02, 0.98))
    share = sum(len(each) > 0 for each in moving.values()) / len(moving)
    return TwoMotions(share, photo, (*low, *high))


def _moving_as_one(
    places: Sequence[Float[np.ndarray, "_ 2"]],
    rows: Integer[np.ndarray, "M 2"],
    pair: tuple[int, int],
    sides: Sequence[int],
) -> Float[np.ndarray, "N 2"]:
    """Where the first photo shows what moves; nowhere if nothing does or nothing stays."""
    here, there = (places[photo][rows[:, side]] for side, photo in enumerate(pair))
    side = sides[pair[0]]
    error = STILL_MATCH * side
    for shift in (np.zeros(2), common_shift(here, there, side)):
        still = still_matches(here, there, shift, side)
        moving = np.linalg.norm(there - here - shift, axis=1) > MOVED_MATCH * side
        if not still.any() or moving.sum() < MIN_MATCHES:
            continue
        cv2.setRNGSeed(0)
        geometry, fits = cv2.findFundamentalMat(here[moving], there[moving], cv2.FM_RANSAC, error)
        if fits is None or fits.sum() < max(MIN_MATCHES, MIN_FITTING * len(fits)):
            continue
        if shift.any() and _fit(geometry, here[still], there[still], error) > MIN_FITTING:
            continue  # before a wall that is far away a scene that stands still does the same
        return here[moving][fits[:, 0] > 0]
    return here[:0]


def common_shift(
    here: Float[np.ndarray, "M 2"], there: Float[np.ndarray, "M 2"], side: int
) -> Float[np.ndarray, "2"]:
    """The displacement that most matches have, but for an error."""
    shifts, error = there - here, STILL_MATCH * side
    alike = KDTree(shifts).query_ball_point(shifts, error, return_length=True)
    return shifts[np.linalg.norm(shifts - shifts[alike.argmax()], axis=1) < error].mean(axis=0)


def still_matches(
    here: Float[np.ndarray, "M 2"],
    there: Float[np.ndarray, "M 2"],
    shift: Float[np.ndarray, "2"],
    side: int,
) -> Bool[np.ndarray, " M"]:
    """Which matches show a room that shifts by so much; none if they are few or lie close together.

    A room's lie far apart: the centre of an orbit, which stays as well, is smaller.
    """
    still = np.linalg.norm(there - here - shift, axis=1) < STILL_MATCH * side
    is_room = still.sum() >= MIN_MATCHES and here[still].std(axis=0).max() >= FEATURE_SPREAD * side
    return still & is_room


def _fit(
    geometry: Float[np.ndarray, "3 3"],
    here: Float[np.ndarray, "M 2"],
    there: Float[np.ndarray, "M 2"],
    error: float,
) -> float:
    """The share of matches whose places are on the epipolar lines of the others."""
    lines = np.c_[here, np.ones(len(here))] @ geometry.T
    away = np.abs((lines * np.c_[there, np.ones(len(there))]).sum(axis=1))
    return float((away < error * np.linalg.norm(lines[:, :2], axis=1)).mean())


def spread_box(
    places: Sequence[Float[np.ndarray, "_ 2"]],
    matches: Matches,
    sides: Sequence[int],
    first: int,
    box: PhotoBox,
) -> list[Float[np.ndarray, " _"]]:
    """How much each feature belongs to the object in a box, from -1 to 1.

    From the photo with the box to those that share most matches with the ones that are known.
    Features that stay at their pixel in most of the photos that show them are background.
    """
    still = _still_features(places, matches, sides)
    linked: dict[int, list[tuple[int, Integer[np.ndarray, "M 2"]]]] = {}
    for (a, b), rows in matches.items():
        linked.setdefault(a, []).append((b, rows))
        linked.setdefault(b, []).append((a, rows[:, ::-1]))
    (x0, y0, x1, y1), (x, y) = box, places[first].T
    inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
    found = {first: np.where(inside & ~still[first], 1.0, -1.0)}
    votes = [np.zeros((len(each), 2)) for each in places]  # sum and number
    near = np.zeros(len(places))
    at = first
    while True:
        for other, rows in linked.get(at, []):
            if other not in found:
                np.add.at(
                    votes[other], rows[:, 1], np.c_[found[at][rows[:, 0]], np.ones(len(rows))]
                )
                near[other] += len(rows)
        near[at] = 0
        at = int(near.argmax())
        if not near[at]:
            break
        voted = votes[at][:, 1] > 0
        values = votes[at][voted, 0] / votes[at][voted, 1]
        found[at] = _nearest_mean(places[at][voted], values, places[at])
        found[at][voted] = values
        found[at][still[at]] = -1
    return [found.get(row, -np.ones(len(each))) for row, each in enumerate(places)]


def _still_features(
    places: Sequence[Float[np.ndarray, "_ 2"]], matches: Matches, sides: Sequence[int]
) -> list[Bool[np.ndarray, " _"]]:
    counts = [np.zeros((len(each), 2)) for each in places]
    for pair, rows in matches.items():
        here, there = (places[photo][rows[:, side]] for side, photo in enumerate(pair))
        still = np.linalg.norm(here - there, axis=1) < STILL_MATCH * sides[pair[0]]
        for side, photo in enumerate(pair):
            np.add.at(counts[photo], rows[:, side], np.c_[still, np.ones(len(rows))])
    return [(each[:, 0] >= 2) & (2 * each[:, 0] > each[:, 1]) for each in counts]


def _nearest_mean(
    places: Float[np.ndarray, "P 2"], values: Float[np.ndarray, " P"], at: Float[np.ndarray, "Q 2"]
) -> Float[np.ndarray, " Q"]:
    if not len(places) or not len(at):
        return -np.ones(len(at))
    near = KDTree(places).query(at, k=min(FEATURE_NEIGHBOURS, len(places)))[1].reshape(len(at), -1)
    return values[near].mean(axis=1)


def pixels_near_features(
    places: Float[np.ndarray, "P 2"], values: Float[np.ndarray, " P"], size: tuple[int, int]
) -> Bool[np.ndarray, "H W"]:
    """The pixels close to features of the object, and closer than to others."""
    width, height = size
    if not (values > 0).any():
        return np.zeros((height, width), bool)
    grid = np.stack(np.meshgrid(*(np.arange(0, n, GRID) + GRID / 2 for n in size)), axis=-1)
    shown = _nearest_mean(places, values, grid.reshape(-1, 2)).reshape(grid.shape[:2])
    away = KDTree(places[values > 0]).query(grid.reshape(-1, 2))[0].reshape(grid.shape[:2])
    shown[away > FEATURE_REACH * max(size)] = -1
    enlarged = cv2.resize(shown, (grid.shape[1] * GRID, grid.shape[0] * GRID))
    return enlarged[:height, :width] > 0


def cut_out_pixels(path: Path) -> Bool[np.ndarray, "H W"]:
    """What is opaque in a cut-out, or differs from its plain surroundings."""
    pixels = decode(path, upright=True)
    if pixels.shape[2] > 3 and (pixels[..., 3] < PHOTO_OPAQUE).any():
        return pixels[..., 3] >= PHOTO_OPAQUE
    grey = pixels[..., :3].mean(axis=2)
    rim = np.concatenate([grey[0], grey[-1], grey[:, 0], grey[:, -1]])
    plain = np.abs(grey - np.median(rim)) < FEATURE_PLAIN
    parts = cv2.connectedComponents(plain.astype(np.uint8))[1]
    outside = np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))
    return ~(plain & np.isin(parts, outside))


def cut_out_mask(path: Path) -> Bool[np.ndarray, "H W"]:
    """Where to find features in a cut-out: not at its outline."""
    mask = cut_out_pixels(path).astype(np.uint8)
    return cv2.erode(mask, np.ones((OUTLINE, OUTLINE)), borderValue=1) > 0


def write_masks(masks: MaskReaders, photos: Path, names: Sequence[str], folder: Path) -> Path:
    """Write the masks of photos at their sizes, for COLMAP, and return the folder."""
    if missing := [name for name in names if name not in masks]:
        raise StyleSplatError(
            f"There is no mask of {join_names(missing)} ({len(missing)} of {len(names)} photos). "
            "Add them, or leave these photos out."
        )
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shares = []
    for name, file in zip(names, numbered_files(names), strict=True):
        size = image_sizes(resolve_within(photos, name))[1]
        mask = masks[name]()
        if not same_shape(mask.shape[::-1], size):
            raise StyleSplatError(
                f"The mask of {name} is {mask.shape[1]}x{mask.shape[0]}, which is not the shape of "
                f"the photo ({size[0]}x{size[1]}). Make it from that photo."
            )
        pixels = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        shares.append(pixels.mean())
        Image.fromarray(255 * pixels).save(folder / mask_file(file))
    if min(shares) == 1 or max(shares) == 0:
        what = "every pixel" if min(shares) == 1 else "no pixel"
        raise StyleSplatError(f"The masks show {what} of each photo. Check --masks.")
    return folder
