"""What the comparison of photos found, by their names."""

from collections import Counter
from dataclasses import dataclass

from stylesplat.posing.pairs import PAIR_ID
from stylesplat.posing.workplace import Workplace

# COLMAP's kinds of pairs that one homography explains: of something flat, or of a camera that
# only turned
FLAT = (4, 5, 6)
QUERY = "SELECT pair_id, rows, config FROM two_view_geometries"


@dataclass(frozen=True)
class MatchTable:
    """The pairs of photos that were compared."""

    compared: int
    """How many they are."""
    matches: dict[tuple[str, str], int]
    """By two names, in either order, the matches that fit one geometry; only where there are."""
    flat: int
    """How many of the matched pairs a turned camera explains, or something flat."""

    @property
    def matched(self) -> int:
        """How many pairs match."""
        return len(self.matches) // 2

    def partners(self, name: str) -> Counter[str]:
        """The photos that one matches, and in how many features."""
        return Counter({b: count for (a, b), count in self.matches.items() if a == name})


def match_table(place: Workplace) -> MatchTable:
    """Read what is in the database."""
    names = dict(zip(place.files, place.names, strict=True))
    named = {key: names[file] for key, file in place.ask("SELECT image_id, name FROM images")}
    rows = place.ask(QUERY)
    matches: dict[tuple[str, str], int] = {}
    for key, count, _ in rows:
        one, other = named[key // PAIR_ID], named[key % PAIR_ID]
        if count:
            matches[one, other] = matches[other, one] = count
    flat = sum(kind in FLAT for _, count, kind in rows if count)
    return MatchTable(len(rows), matches, flat)
