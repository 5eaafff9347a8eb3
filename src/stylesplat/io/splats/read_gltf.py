"""Splats out of glTF 2.0 files (`.glb`, `.gltf`) with Khronos' KHR_gaussian_splatting.

The extension is Khronos' (https://github.com/KhronosGroup/glTF, extensions/2.0/Khronos): its scales
are standard deviations and its opacities shares, where PLY has logarithms and logits; its
harmonics are the INRIA code's, sign by sign.
"""

from pathlib import Path
from typing import Any

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import brief
from stylesplat.io.splats.gltf_accessors import Numbers
from stylesplat.io.splats.gltf_document import (
    DISPLAYED,
    SPZ,
    Gltf,
    Packed,
    Primitive,
    Splatting,
    harmonic,
    higher_bands,
    named,
    open_gltf,
    open_json,
)
from stylesplat.io.splats.gltf_places import placed_splats
from stylesplat.io.splats.splat_ply import check_splats, of_degree
from stylesplat.io.splats.spz import spz_within
from stylesplat.progress import say
from stylesplat.scene.frames import move_splats
from stylesplat.scene.splats import Splats

SMALLEST_ROW = 12  # bytes of a Gaussian, were all that it has the same three numbers
SMALLEST = torch.finfo(torch.float32).tiny  # a standard deviation of 0 has no logarithm
POINTS = 0  # the mode of a primitive that is drawn as points
BANDS = (0, 3, 8, 15)  # higher bands up to each degree


def read_gltf(path: Path | str) -> Splats:
    """Read the splats that a glTF file shows, into PLY's axes.

    What the nodes do to them is done, and the world is turned half about z: glTF's has y up, that
    of COLMAP, INRIA's code and `import` has y down. So a file that StyleSplat wrote comes back as
    it was, and one that PlayCanvas made of a PLY has that PLY's frame. Several sets of splats
    become one.

    Raises:
        StyleSplatError: If the file is missing, of other content than its name says, damaged,
            holds no splats, or stores or places them in a way that is not read.
    """
    gltf = open_gltf(Path(path))
    numbers = Numbers(gltf)
    parts, count = list[Splats](), 0
    for primitive, frame in placed_splats(gltf):
        part = check_splats(_splats(numbers, primitive), path)
        parts.append(part if frame is None else check_splats(move_splats(part, frame), path))
        count += len(part)
        if count * SMALLEST_ROW > numbers.size:
            fault = f"it shows {count} Gaussians, which {numbers.size} bytes cannot hold"
            raise gltf.refusal(fault, "Export it without instances.")
    return parts[0] if len(parts) == 1 else _together(parts)


def announced_in_gltf(path: Path | str) -> int:
    """How many Gaussians a glTF file says that it shows; what it has of them is not read.

    Raises:
        StyleSplatError: If the file is missing, its JSON is damaged, or it holds no splats.
    """
    numbers = Numbers(open_json(Path(path)))
    places = (each.attributes.get("POSITION") for each, _ in placed_splats(numbers.gltf))
    return sum(numbers.accessor(n, "POSITION").count for n in places if n is not None)


def _splats(numbers: Numbers, primitive: Primitive) -> Splats:
    """The splats of a primitive, in its own frame."""
    gltf = numbers.gltf
    assert primitive.extensions.splatting is not None
    splatting = primitive.extensions.splatting
    _check_kind(gltf, primitive, splatting)
    packed = [splatting.extensions[name] for name in SPZ if name in splatting.extensions]
    if packed:
        return _unpacked(numbers, primitive, packed[0])
    degree = _degree(gltf, primitive)
    means = _column(numbers, primitive, "POSITION", 3)
    quats = _column(numbers, primitive, named("ROTATION"), 4)
    scales = _column(numbers, primitive, named("SCALE"), 3)
    if (scales < 0).any():
        raise gltf.refusal(f"{int((scales < 0).sum())} standard deviations are negative")
    shN = torch.empty(len(means), BANDS[degree], 3)
    for band, name in enumerate(higher_bands(degree)):
        shN[:, band] = _column(numbers, primitive, name, 3)
    return Splats(
        means=means,
        quats=quats[:, [3, 0, 1, 2]],
        scales=scales.clamp_(min=SMALLEST).log_(),
        opacities=_logits(numbers, primitive),
        sh0=_column(numbers, primitive, harmonic(0, 0), 3)[:, None],
        shN=shN,
    )


def _unpacked(numbers: Numbers, primitive: Primitive, packed: Any) -> Splats:
    """Those of a primitive as SPZ: its axes are the primitive's, unlike those of a `.spz`."""
    try:
        view = msgspec.convert(packed, Packed).buffer_view
    except msgspec.ValidationError as error:
        raise numbers.gltf.refusal(f"what it says of its SPZ is none ({error})") from error
    splats = spz_within(bytes(numbers.stretch(view, "SPZ")), numbers.gltf.path)
    numbers.count_unpacked(view, sum(column.nbytes for column in splats.tensors().values()))
    places = primitive.attributes.get("POSITION")
    expected = len(splats) if places is None else numbers.accessor(places, "POSITION").count
    if len(splats) != expected:
        fault = f"its splats have {expected} places, but {len(splats)} rows of SPZ"
        raise numbers.gltf.refusal(fault)
    return splats


def _logits(numbers: Numbers, primitive: Primitive) -> Float[Tensor, " N"]:
    """Those of the opacities: 0 and 1, which have none, count as half a step from there."""
    name = named("OPACITY")
    values = _column(numbers, primitive, name, 1)[:, 0]
    outside = int(((values < 0) | (values > 1)).sum())
    if outside:
        raise numbers.gltf.refusal(f"{outside} opacities are not between 0 and 1")
    step = numbers.step(primitive.attributes[name], name)
    low = SMALLEST if step < 1e-6 else step / 2  # float32 is fine near 0, and coarse near 1
    return values.double().clamp(low, 1 - step / 2).logit().float()


def _column(numbers: Numbers, primitive: Primitive, name: str, width: int) -> Float[Tensor, "N D"]:
    """The rows of an attribute, as many as there are places."""
    if name not in primitive.attributes:
        raise numbers.gltf.refusal(f"its splats have no {name}")
    index, places = primitive.attributes[name], primitive.attributes.get("POSITION", 0)
    count = numbers.accessor(index, name).count
    expected = numbers.accessor(places, "POSITION").count
    if count != expected:
        fault = f"its splats have {expected} places, but {count} rows of {name}"
        raise numbers.gltf.refusal(fault)
    return torch.from_numpy(numbers.rows(index, name, width))


def _check_kind(gltf: Gltf, primitive: Primitive, splatting: Splatting) -> None:
    """Refuse splats that are stored or drawn in another way; say what else is different."""
    unread = [name for name in splatting.extensions if "compression" in name and name not in SPZ]
    if unread:
        fault = f"its splats are compressed ({unread[0]:.60}), which is not read here"
        raise gltf.refusal(fault, "Export it without compression, or as .ply or .spz.")
    if splatting.kernel != "ellipse":
        fault = f"its splats are no ellipses, but {brief(splatting.kernel)!r}"
        raise gltf.refusal(fault, "Export it as .ply.")
    if primitive.mode != POINTS:
        raise gltf.refusal(f"its splats are no points, but of mode {primitive.mode}")
    if splatting.color_space != DISPLAYED:
        say(
            f"{gltf.path} has its colours in {brief(splatting.color_space)!r}: they are taken for "
            f"{DISPLAYED}, in which they may look darker."
        )


def _degree(gltf: Gltf, primitive: Primitive) -> int:
    """Up to which degree there are harmonics; a degree is whole and follows the one below."""
    there = [name for name in primitive.attributes if name.startswith(named("SH_DEGREE_"))]
    for degree in reversed(range(len(BANDS))):
        wanted = {harmonic(0, 0), *higher_bands(degree)}
        if wanted <= {*there}:
            break
    else:
        raise gltf.refusal(f"its splats have no {harmonic(0, 0)}")
    left = [name for name in there if name not in wanted]
    if any(int(part) < len(BANDS) for name in left if (part := name.split("_")[4]).isdigit()):
        raise gltf.refusal(f"its splats have {brief(left[0])}, but not all of its degree and below")
    if left:
        say(f"{gltf.path} has colours of a higher degree than 3: left out.")
    return degree


def _together(parts: list[Splats]) -> Splats:
    """One after the other, with the colours of the highest degree that one has."""
    degree = max(part.sh_degree for part in parts)
    parts = [of_degree(part, degree) for part in parts]
    columns = zip(*(part.tensors().values() for part in parts), strict=True)
    means, quats, scales, opacities, sh0, shN = map(torch.cat, columns)
    return Splats(means, quats, scales, opacities, sh0, shN)
