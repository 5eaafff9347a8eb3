"""What the comparison of photos found, by their names."""

from collections import Counter
from dataclasses import dataclass

from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.structure_from_motion.workplace import Workplace

# COLMAP's kinds of pairs that one homography explains: of something flat, or of a camera that
# only turned
FLAT = (4, 5, 6)


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
    with place.opened() as database:
        named = {image.image_id: names[image.name] for image in database.read_all_images()}
        compared = database.num_verified_image_pairs()
        keys, geometries = database.read_two_view_geometries()  # of those that match
    matches: dict[tuple[str, str], int] = {}
    for key, geometry in zip(keys, geometries, strict=True):
        one, other = (named[image] for image in pycolmap.pair_id_to_image_pair(key))
        matches[one, other] = matches[other, one] = len(geometry.inlier_matches)
    flat = sum(geometry.config in FLAT for geometry in geometries)
    return MatchTable(compared, matches, flat)
