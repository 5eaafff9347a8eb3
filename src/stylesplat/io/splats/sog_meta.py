"""What the meta.json of a SOG declares."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from msgspec import Meta

from stylesplat.errors import brief
from stylesplat.io.json_files import PhotoName, fitting
from stylesplat.io.splats.codebooks import VALUES

VERSION = 2
PALETTE = 2**16  # entries: as many as two bytes can name
MOST = 2**28  # Gaussians: WebP has sides of 14 bits
FARTHEST = 30.0  # logarithm of a place: nothing is so far, and float32 holds it

Logarithm = Annotated[float, Meta(ge=-FARTHEST, le=FARTHEST)]
Place = tuple[Logarithm, Logarithm, Logarithm]
Number = Annotated[float, Meta(ge=-1e30, le=1e30)]  # float32 holds it; what is absurd is told later
Codebook = Annotated[tuple[Number, ...], Meta(min_length=1, max_length=VALUES)]
Count = Annotated[int, Meta(ge=0, le=MOST)]


@dataclass(frozen=True)
class Quats:
    """Rotations."""

    files: tuple[PhotoName]
    """The picture."""


@dataclass(frozen=True)
class Means:
    """Places, as sign(x) * log(1 + |x|)."""

    mins: Place
    """What 0 means along each axis."""
    maxs: Place
    """What 65535 means."""
    files: tuple[PhotoName, PhotoName]
    """The pictures of the lower bytes and of the upper ones."""


@dataclass(frozen=True)
class Coded:
    """Numbers that are bytes, and what each byte means."""

    codebook: Codebook
    """The values."""
    files: tuple[PhotoName]
    """The picture."""


@dataclass(frozen=True)
class Palette:
    """Higher bands of colour: the entries, and which one each Gaussian has."""

    count: Annotated[int, Meta(ge=1, le=PALETTE)]
    """Of entries."""
    bands: Literal[1, 2, 3]
    """The degree."""
    codebook: Codebook
    """What each byte of an entry means."""
    files: tuple[PhotoName, PhotoName]
    """The picture of the entries, and the one of the choices."""


@dataclass(frozen=True)
class SogMeta:
    """All of it, as far as it matters here."""

    version: Literal[2]
    """Of the format."""
    count: Count
    """Of Gaussians."""
    means: Means
    """Their places."""
    scales: Coded
    """Logarithms of their standard deviations."""
    quats: Quats
    """Their rotations."""
    sh0: Coded
    """Their colours' constant bands, and opacities."""
    shN: Palette | None = None
    """Their colours' higher bands."""


def sog_meta(content: dict[str, Any], what: str) -> SogMeta:
    """The declaration of a meta.json.

    Raises:
        StyleSplatError: If it is of another version, or something is missing or absurd.
    """
    version = content.get("version", 1)
    if version != VERSION:
        what = f"{what} as SOG of version {brief(str(version))}, only {VERSION} is read here"
        content = {**content, "version": version if isinstance(version, int) else 0}
    return fitting(content, SogMeta, what, "Export it again, as version 2.")
