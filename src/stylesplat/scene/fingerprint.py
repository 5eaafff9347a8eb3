"""What a capture is, in one line of text, so that work on it is not continued with another."""

from collections.abc import Iterable
from hashlib import blake2b

from torch import Tensor

from stylesplat.scene.capture import Capture
from stylesplat.scene.sampling import evenly

PHOTOS = 5  # that are read; whoever exchanges photos exchanges all of them, or renames them
DIGEST = 8  # bytes of each part


def fingerprint(capture: Capture, *, photos: int = PHOTOS) -> str:
    """Digests of a capture's parts: equal for equal captures, wherever they lie.

    All label maps are read, once and one at a time, but only a few photos: about 0.6 s for 50
    captured at 1080x1920, and 3 s for 300 at 1600x1066.

    Args:
        capture: At the size that it is used at.
        photos: How many of them to look at, evenly chosen.

    Returns:
        `PART=DIGEST`, separated by spaces; see `differences`.
    """
    rows = evenly(range(len(capture)), photos)
    cameras = capture.cameras
    labels = (capture.labels(row) for row in range(len(capture)))
    parts = {
        "names": _digest([repr(cameras.names)]),
        "size": _digest([cameras.sizes.long()]),
        "poses": _digest([cameras.viewmats.float(), cameras.Ks.float()]),
        "points": _digest([capture.points, capture.point_colors]),
        "labels": _digest(None if one is None else one.int() for one in labels),
        "objects": _digest([repr(sorted(capture.object_names.items()))]),
        "photos": _digest(one for row in rows for one in (capture.photos[row], capture.alpha(row))),
    }
    return " ".join(f"{part}={digest}" for part, digest in parts.items())


SAID = {
    "names": "other photos",
    "size": "photos of another size",
    "poses": "other poses",
    "points": "other points",
    "labels": "other label maps",
    "objects": "other names of objects",
    "photos": "photos that look otherwise",
}
CAUSES = ("names", "size")  # which change nearly everything after them


def differences(one: str, other: str) -> list[str]:
    """In a few words each, in what the captures of two fingerprints differ.

    Example:
        >>> differences("size=1 poses=2 labels=3", "size=1 poses=2 labels=4")
        ['other label maps']
    """
    mine, theirs = (dict(part.split("=") for part in text.split()) for text in (one, other))
    changed = [part for part in SAID if mine.get(part) != theirs.get(part)]
    cause = [part for part in changed if part in CAUSES]
    return [SAID[part] for part in cause[:1] or changed]


def _digest(parts: Iterable[Tensor | str | None]) -> str:
    digest = blake2b(digest_size=DIGEST)
    for part in parts:
        if isinstance(part, Tensor):
            content = part.cpu().contiguous()
            digest.update(f"{part.dtype}{[*part.shape]}".encode())
            digest.update(content.numpy().tobytes())
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()
