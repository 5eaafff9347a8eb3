"""Which photo a mask is of, by the names of both."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import PurePosixPath

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say


def match_masks(keys: Iterable[str], names: Sequence[str]) -> dict[str, str]:
    """The photo of each mask; masks of no photo are left out.

    If no name fits, upper and lower case do not count; if none fits then, something before or
    after all names, as in `0001_mask`, does not.

    Args:
        keys: Paths of masks without their suffix, which may still have that of the photo.
        names: The photos' names.

    Raises:
        StyleSplatError: If two masks are of one photo, or one is of one of several of which not
            all have another.
    """
    keys = [*keys]
    found = _match(keys, names)
    if found:
        return found
    folded, lower = {key.casefold(): key for key in keys}, {n.casefold(): n for n in names}
    if len(folded) < len(keys) or len(lower) < len(names):
        return {}
    matches = _match([*folded], [*lower]) or _match_affixed([*folded], [*lower])
    return {folded[key]: lower[name] for key, name in matches.items()}


def without_suffix(name: str) -> str:
    return PurePosixPath(name).with_suffix("").as_posix()


def _match(keys: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """The photo of each mask: the one whose path the mask's path ends with.

    If there is none, the mask's bare name decides, as long as it lies in no folder of photos and
    only one photo has that name. A mask that lies just where its photo does precedes others.
    """
    by_path: dict[str, list[str]] = {}
    by_stem: dict[str, list[str]] = {}
    for name in names:
        for path in {name, without_suffix(name)}:
            by_path.setdefault(path, []).append(name)
            by_stem.setdefault(PurePosixPath(path).name, []).append(name)
    folders = {PurePosixPath(name).parent.as_posix() for name in names} - {"."}

    def photos_by_stem(key: str) -> list[str]:
        *folder, stem = PurePosixPath(key).parts
        among_photos = any(end in folders for end in _path_ends("/".join(folder)))
        return [] if among_photos else by_stem.get(stem, [])

    exact = {photo for key in keys if len(own := by_path.get(key, [])) == 1 for photo in own}
    found = {k: next((by_path[e] for e in _path_ends(k) if e in by_path), []) for k in keys}
    matches = {
        key: photos[0]
        for key, photos in found.items()
        if len(photos) == 1 and (key in by_path or photos[0] not in exact)
    }
    taken = {*matches.values()}
    for key in [key for key in found if key not in matches]:
        photos = found[key] or photos_by_stem(key)
        left = [photo for photo in photos if photo not in taken]
        if left and len(photos) > 1:
            raise StyleSplatError(
                f"The mask {key} may be of {photos[0]} or of {photos[1]}. Name masks like the "
                f"photos, with their folders: {without_suffix(left[0])}.png."
            )
        if left:
            matches[key] = left[0]
    return _once(matches)


def _match_affixed(keys: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Masks and photos whose names differ by what stands before and behind all of either."""
    masks = [(PurePosixPath(key).name, key) for key in keys]
    photos = [(PurePosixPath(name).stem, name) for name in names]
    for longer, shorter in ((masks, photos), (photos, masks)):
        affixes = Counter(
            (long[:start], long[start + len(short) :])
            for long, _ in longer
            for short, _ in shorter
            if short and (start := long.find(short)) >= 0 and _stands_alone(long, short, start)
        )
        known = dict(shorter)
        for (before, behind), count in affixes.most_common(1):
            pairs = [
                (own, known[long[len(before) : len(long) - len(behind)]])
                for long, own in longer
                if long.startswith(before)
                and long.endswith(behind)
                and long[len(before) : len(long) - len(behind)] in known
            ]
            if 2 * count > len(masks) and len(known) == len(shorter):
                found = _once(dict(pairs if longer is masks else ((m, p) for p, m in pairs)))
                key, photo = next(iter(found.items()))
                say(
                    f"No mask is named like a photo: {key} is taken for that of {photo}, and so on."
                )
                return found
    return {}


def _stands_alone(long: str, short: str, start: int) -> bool:
    """Whether a number in a name is a whole one: 001 is none in 1001."""
    end = start + len(short)
    before = long[start - 1 : start].isdigit() and short[0].isdigit()
    return not before and not (long[end : end + 1].isdigit() and short[-1].isdigit())


def _once(matches: dict[str, str]) -> dict[str, str]:
    used: dict[str, str] = {}
    for key, photo in matches.items():
        if (other := used.setdefault(photo, key)) != key:
            raise StyleSplatError(
                f"Both {other} and {key} are named like {photo}. Give the folder of one kind."
            )
    return matches


def _path_ends(path: str) -> list[str]:
    parts = PurePosixPath(path).parts
    return ["/".join(parts[start:]) for start in range(len(parts))]
