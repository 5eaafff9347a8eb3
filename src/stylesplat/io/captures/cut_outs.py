"""Photos whose background is transparent: their colours, their alpha, the object they show."""

from collections.abc import Sequence
from functools import partial

from jaxtyping import Int, UInt8
from torch import Tensor

from stylesplat.io.captures.photos import OPAQUE, Photo
from stylesplat.scene.cache import Cache, Lazy
from stylesplat.scene.sampling import evenly

LOOKED_AT = 5  # photos with an alpha channel: most of those there are have nothing transparent
RECENT = 2**27  # bytes: the photo read last, so that colours and alpha are decoded together
NAMES = {1: "object"}  # what a cut-out shows, by label id


def are_cut_out(photos: Sequence[Photo]) -> bool:
    """Whether some of the photos are transparent somewhere, judged by a few.

    Raises:
        StyleSplatError: If a file is no longer readable.
    """
    some = evenly([photo for photo in photos if photo.has_alpha()], LOOKED_AT)
    return any(photo.is_cut_out() for photo in some)


def split_alpha(
    photos: Sequence[Photo],
) -> tuple[Lazy[UInt8[Tensor, "H W 3"]], Lazy[UInt8[Tensor, "H W"] | None]]:
    """Colours over black and alphas of photos, read on access."""
    recent: Cache[int] = Cache(RECENT)

    def pixels(row: int) -> UInt8[Tensor, "H W D"]:
        return recent.get(row, lambda: (photos[row].read_with_alpha(),))[0]

    def colors(row: int) -> UInt8[Tensor, "H W 3"]:
        return pixels(row)[..., :3].contiguous()

    def alpha(row: int) -> UInt8[Tensor, "H W"] | None:
        both = pixels(row)
        return both[..., 3].contiguous() if both.shape[-1] > 3 else None

    rows = range(len(photos))
    return Lazy([partial(colors, row) for row in rows]), Lazy([partial(alpha, row) for row in rows])


def object_maps(alphas: Lazy[UInt8[Tensor, "H W"] | None]) -> Lazy[Int[Tensor, "H W"] | None]:
    """Label maps that say where photos are opaque; None where one has no alpha."""

    def labels(row: int) -> Int[Tensor, "H W"] | None:
        alpha = alphas[row]
        return None if alpha is None else (alpha >= OPAQUE).int()

    return Lazy([partial(labels, row) for row in range(len(alphas))])
