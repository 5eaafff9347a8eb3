"""Which pairs of photos are compared, and the comparison."""

from itertools import combinations

from jaxtyping import Int
from torch import Tensor

from stylesplat.structure_from_motion.likeness import alike
from stylesplat.structure_from_motion.workplace import Workplace

# Photos of which all pairs are compared: 1770 take 20 s on two cores, and miss nothing
EXHAUSTIVE = 60
SIMILAR = 20  # photos that each is compared to if they are more: 9 of 10 matches of fox
IN_A_ROW = 10  # photos that each is compared to of those after it in time; then 16, 32 and so on

Pairs = set[tuple[int, int]]


def match_photos(place: Workplace, *, ordered: bool) -> None:
    """Compare the pairs of photos that have not been compared yet.

    Args:
        place: With the features of all photos.
        ordered: Whether neighbours in the list were neighbours in time.

    Raises:
        StyleSplatError: If the disk is full.
    """
    pairs = sorted(choose_pairs(place, ordered=ordered))
    if missing := _missing(place, pairs):
        place.run(
            "match_pairs",
            "matching photos",
            len(pairs),
            "pair",
            done=len(pairs) - len(missing),
            pairs=[(place.files[one], place.files[other]) for one, other in missing],
            list=str(place.folder / "pairs.txt"),
        )


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


def _missing(place: Workplace, pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The pairs that have not been compared."""
    with place.opened() as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        keys = [ids.get(file) for file in place.files]  # None: COLMAP could not read it

        def is_compared(one: int | None, other: int | None) -> bool:
            if one is None or other is None:
                return False
            return database.exists_two_view_geometry(one, other)

        return [(one, other) for one, other in pairs if not is_compared(keys[one], keys[other])]
