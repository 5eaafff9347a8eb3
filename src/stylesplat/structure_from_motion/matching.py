"""Which pairs of photos are matched, and the matches."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize, pad

from stylesplat.photo_libraries import pycolmap
from stylesplat.progress import track
from stylesplat.structure_from_motion.workspace import Workspace

# Photos of which all pairs are matched: 1770 take 20 s on two cores, and miss nothing
EXHAUSTIVE = 60
SIMILAR = 20  # photos that each is matched with if they are more: 9 of 10 matches of fox
CONSECUTIVE = 10  # photos that each is matched with of those after it; then 16, 32 and so on
ORBIT_NEIGHBOURS = 5  # photos before and after that each is matched with on a turntable
# Image retrieval after Wu, Towards Linear-Time Incremental Structure from Motion, 2013. With 128
# features 97 of 100 of fox's most similar pairs do match; twice as many features change nothing
LARGEST_FEATS, DESCRIPTOR = 128, 128
MAX_RATIO = 0.8  # of the angles to the best and the second-best match, as COLMAP has it
# COLMAP's configurations of pairs that one homography explains: something flat, or a camera that
# only turned
PLANAR = (4, 5, 6)

Pairs = set[tuple[int, int]]


@dataclass(frozen=True)
class MatchTable:
    compared: int
    matches: dict[tuple[str, str], int]
    """By two names, in either order, the matches that fit one geometry; only where there are."""
    planar: int
    """How many of the matched pairs one homography explains."""

    @property
    def matched(self) -> int:
        return len(self.matches) // 2


def match_pairs(workspace: Workspace, pairs: Pairs) -> MatchTable:
    """Match the pairs of photos that have not been matched yet."""
    if missing := _not_compared(workspace, sorted(pairs)):
        workspace.run(
            "match_pairs",
            "matching photos",
            len(pairs),
            "pair",
            done=len(pairs) - len(missing),
            pairs=[(workspace.files[one], workspace.files[other]) for one, other in missing],
            list=str(workspace.folder / "pairs.txt"),
            moves=workspace.masks is not None,
        )
    with workspace.open_database() as database:
        names = {i.image_id: workspace.name_of[i.name] for i in database.read_all_images()}
        compared = database.num_verified_image_pairs()
        keys, geometries = database.read_two_view_geometries()  # of those that match
    matches: dict[tuple[str, str], int] = {}
    for key, geometry in zip(keys, geometries, strict=True):
        one, other = (names[image] for image in pycolmap.pair_id_to_image_pair(key))
        matches[one, other] = matches[other, one] = len(geometry.inlier_matches)
    planar = sum(geometry.config in PLANAR for geometry in geometries)
    return MatchTable(compared, matches, planar)


def choose_pairs(workspace: Workspace, *, ordered: bool) -> Pairs:
    """Rows of the photos to match, the smaller first."""
    count, matching = len(workspace.names), workspace.config.matching
    if matching == "exhaustive" or (matching == "auto" and count <= EXHAUSTIVE):
        return set(combinations(range(count), 2))
    similar = similar_pairs(image_similarity(workspace), SIMILAR)  # closes loops of sequences
    if matching == "sequential" or (matching == "auto" and ordered):
        similar |= sequential_pairs(count)
    return similar


def orbit_pairs(count: int) -> Pairs:
    """Neighbours on a closed orbit.

    Photos from other sides look alike where a pattern repeats all around the object, and would turn
    it the wrong way: a vase with twenty equal scales was seen from 276 of 360 degrees.

    Example:
        >>> sorted(orbit_pairs(100))[:6]
        [(0, 1), (0, 2), (0, 3), (0, 4), (0, 5), (0, 95)]
    """
    pairs = (
        (row, (row + step) % count)
        for step in range(1, ORBIT_NEIGHBOURS + 1)
        for row in range(count)
    )
    return {(min(pair), max(pair)) for pair in pairs if pair[0] != pair[1]}


def sequential_pairs(count: int) -> Pairs:
    """Neighbours in time, and some that are farther apart.

    Example:
        >>> sorted(other for one, other in sequential_pairs(100) if one == 0)
        [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 16, 32, 64]
    """
    steps = [*range(1, CONSECUTIVE + 1)]
    steps += [2**power for power in range(count.bit_length()) if 2**power > CONSECUTIVE]
    return {(row, row + step) for step in steps for row in range(count - step)}


def similar_pairs(similarity: Int[Tensor, "P P"], neighbours: int) -> Pairs:
    """Each photo with those most similar to it.

    Example:
        >>> import torch
        >>> sorted(similar_pairs(torch.tensor([[0, 5, 1], [5, 0, 2], [1, 2, 0]]), 1))
        [(0, 1), (1, 2)]
    """
    others = similarity.float().fill_diagonal_(-1.0)
    best = others.argsort(dim=1, descending=True, stable=True)[:, :neighbours]
    chosen = ((min(a, b), max(a, b)) for a, row in enumerate(best.tolist()) for b in row)
    return {pair for pair in chosen if pair[0] != pair[1]}


def pairs_between(similarity: Int[Tensor, "P P"], groups: Sequence[int], most: int) -> Pairs:
    """The most similar pairs of photos that are in different groups.

    Example:
        >>> import torch
        >>> similarity = torch.tensor([[0, 9, 1, 3], [9, 0, 2, 0], [1, 2, 0, 9], [3, 0, 9, 0]])
        >>> sorted(pairs_between(similarity, [0, 0, 1, 1], 2))
        [(0, 3), (1, 2)]
    """
    rows, columns = torch.triu_indices(len(groups), len(groups), offset=1)
    of = torch.tensor(groups)
    apart = of[rows] != of[columns]
    rows, columns = rows[apart], columns[apart]
    best = similarity[rows, columns].argsort(descending=True, stable=True)[:most]
    return {*zip(rows[best].tolist(), columns[best].tolist(), strict=True)}


def image_similarity(workspace: Workspace) -> Int[Tensor, "P P"]:
    """How many of the largest features of two photos match; 0 for a photo and itself."""
    feats = torch.stack([_largest_features(workspace, file) for file in workspace.files])
    rows = track(range(len(feats)), "comparing photos", unit="photo")
    matches = torch.stack([_count_matches(feats[row], feats) for row in rows])
    return (matches + matches.T).fill_diagonal_(0)


def _largest_features(workspace: Workspace, file: str) -> Float[Tensor, "L 128"]:
    """The normalized descriptors of a photo's largest features, padded with zeros."""
    with workspace.open_database() as database:
        image = database.read_image_with_name(file)
        if image is None:  # COLMAP could not read it
            return torch.zeros(LARGEST_FEATS, DESCRIPTOR)
        shapes = database.read_keypoints(image.image_id)
        descriptors = database.read_descriptors(image.image_id).data
    areas = np.abs(shapes[:, 2] * shapes[:, 5] - shapes[:, 3] * shapes[:, 4])
    order = np.argsort(-areas, kind="stable")[:LARGEST_FEATS]
    feats = normalize(torch.from_numpy(descriptors[order].astype(np.float32)), dim=1)
    return pad(feats, (0, 0, 0, LARGEST_FEATS - len(feats)))


def _count_matches(
    feats: Float[Tensor, "L 128"], others: Float[Tensor, "P L 128"]
) -> Int[Tensor, " P"]:
    """How many of a photo's features pass the ratio test in each of the others."""
    cosines = torch.einsum("ad,pbd->pab", feats, others)
    best, where = cosines.max(dim=-1)
    second = cosines.scatter_(-1, where[..., None], -1.0).amax(dim=-1)
    clear = best.clamp(-1, 1).acos() < MAX_RATIO * second.clamp(-1, 1).acos()
    return (clear & (best > 0)).sum(dim=-1)


def _not_compared(workspace: Workspace, pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    with workspace.open_database() as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        # None: COLMAP could not read the photo
        keys = [ids.get(file) for file in workspace.files]
        return [
            (one, other)
            for one, other in pairs
            if (a := keys[one]) is None
            or (b := keys[other]) is None
            or not database.exists_two_view_geometry(a, b)
        ]
