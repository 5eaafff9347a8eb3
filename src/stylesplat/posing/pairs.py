"""Which pairs of photos are compared, and the comparison."""

from itertools import combinations

from jaxtyping import Int
from torch import Tensor

from stylesplat.io.files import atomic_path
from stylesplat.posing.likeness import alike
from stylesplat.posing.workplace import Workplace

# Photos of which all pairs are compared: 1770 take 20 s on two cores, and miss nothing
EXHAUSTIVE = 60
SIMILAR = 20  # photos that each is compared to if they are more: 9 of 10 matches of fox
IN_A_ROW = 10  # photos that each is compared to of those after it in time; then 16, 32 and so on
BLOCK = 100  # pairs after which the database is written to
PAIR_ID = 2147483647  # COLMAP's ids of pairs count up to this many photos

Pairs = set[tuple[int, int]]


def match_photos(place: Workplace, *, ordered: bool) -> int:
    """Compare the pairs of photos that have not been compared yet; return how many there are.

    Args:
        place: With the features of all photos.
        ordered: Whether neighbours in the list were neighbours in time.

    Raises:
        StyleSplatError: If the disk is full.
    """
    pairs = sorted(choose_pairs(place, ordered=ordered))
    if _missing(place, pairs):
        listed = place.folder / "pairs.txt"
        with atomic_path(listed) as temporary:
            lines = (f"{place.files[one]} {place.files[other]}\n" for one, other in pairs)
            temporary.write_text("".join(lines), encoding="utf-8")
        place.run(
            "match_pairs", "matching photos", len(pairs), "pair", pairs=str(listed), block=BLOCK
        )
    return len(pairs)


def choose_pairs(place: Workplace, *, ordered: bool) -> Pairs:
    """Rows of the photos to compare, the smaller first."""
    count, matching = len(place.names), place.config.matching
    if matching == "auto" and count <= EXHAUSTIVE:
        matching = "exhaustive"
    if matching == "exhaustive":
        return set(combinations(range(count), 2))
    similar = most_alike(alike(place), SIMILAR)  # closes loops of those in time
    if matching == "sequential" or (matching == "auto" and ordered):
        similar |= in_a_row(count)
    return similar


def in_a_row(count: int) -> Pairs:
    """Neighbours in time, and some that are farther apart.

    Example:
        >>> sorted(other for one, other in in_a_row(100) if one == 0)
        [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 16, 32, 64]
    """
    steps = [*range(1, IN_A_ROW + 1)]
    steps += [2**power for power in range(count.bit_length()) if 2**power > IN_A_ROW]
    return {(row, row + step) for step in steps for row in range(count - step)}


def most_alike(likeness: Int[Tensor, "P P"], neighbours: int) -> Pairs:
    """Each photo with those most like it.

    Example:
        >>> import torch
        >>> sorted(most_alike(torch.tensor([[0, 5, 1], [5, 0, 2], [1, 2, 0]]), 1))
        [(0, 1), (1, 2)]
    """
    others = likeness.float().fill_diagonal_(-1.0)
    best = others.argsort(dim=1, descending=True, stable=True)[:, :neighbours]
    chosen = ((min(a, b), max(a, b)) for a, row in enumerate(best.tolist()) for b in row)
    return {pair for pair in chosen if pair[0] != pair[1]}


def _missing(place: Workplace, pairs: list[tuple[int, int]]) -> bool:
    """Whether a pair has not been compared."""
    rows = {file: row for row, file in enumerate(place.files)}
    row_of = {key: rows[name] for key, name in place.ask("SELECT image_id, name FROM images")}
    done: Pairs = set()
    for (key,) in place.ask("SELECT pair_id FROM two_view_geometries"):
        one, other = sorted((row_of[key // PAIR_ID], row_of[key % PAIR_ID]))
        done.add((one, other))
    return not done.issuperset(pairs)
