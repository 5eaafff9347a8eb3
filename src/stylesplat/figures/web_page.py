"""A web page that holds a splat and what draws it, for any browser, without a server or network.

Numbers are rounded so that pictures of two scenes (a still life and a fox, 100,000 Gaussians)
differ by 58 dB or more for any one of them; the higher bands of colour are coarser, 37 dB.
"""

import json
import re
import zlib
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from scipy.cluster.vq import vq
from torch import Tensor

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.io.atomic import refuse_file, write_file
from stylesplat.io.splats.packing import PACKED_LARGEST, kmeans, morton_order, smallest_three
from stylesplat.io.splats.splat_files import say_left_out
from stylesplat.io.splats.splat_ply import MAX_DEGREE, needed_degree, of_degree
from stylesplat.progress import track
from stylesplat.rendering.reference import MIN_ALPHA
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import extent_of
from stylesplat.scene.layers import UNSEEN
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.scene.virtual_cameras import first_view

ENTRIES = 256  # as many as a byte can name; the first is all zeros
WEB_SAMPLE = 20_000  # rows that a palette is made from
WEB_ROUNDS = 6  # of k-means; more change little
ZERO_BYTE, STEPS = 128, 127  # the byte of 0, and how many there are on each side

Bytes = UInt8[Tensor, "E D"]
WEB_SMALLEST = -12.0  # logarithm of a standard deviation; smaller ones are drawn as this
WEB_COLORS = (-1.0, 2.0)  # mean colours beyond are drawn as these
WEB_TINY = 1e-12  # length, of splats that are all in one place
WEB_LEVELS = 2  # palettes: the entry of the second is added to that of the first
Column = UInt8[Tensor, "..."]


def palette_of(values: Float[Tensor, "M D"]) -> tuple[Bytes, float, Int[Tensor, " M"]]:
    """Entries that rows are like (k-means), as bytes; what the largest byte means; and the entry
    of each row, which is the first for zeros.
    """
    filled = values.ne(0).any(dim=1).numpy()
    entries = np.zeros((ENTRIES, values.shape[1]), np.float32)
    if filled.any():
        sample = np.random.default_rng(0).permutation(values.numpy()[filled])[:WEB_SAMPLE]
        centres, _ = kmeans(sample, ENTRIES - 1, rounds=WEB_ROUNDS)
        entries[1 : 1 + len(centres)] = centres
    strongest = float(np.abs(entries).max()) or 1.0
    palette = torch.from_numpy(entries / strongest * STEPS + ZERO_BYTE).round().byte()
    nearest = torch.from_numpy(vq(values.numpy(), palette_values(palette, strongest).numpy())[0])
    return palette, strongest, nearest.long()


def palette_values(palette: Bytes, strongest: float) -> Float[Tensor, "E D"]:
    return (palette.float() - ZERO_BYTE) / STEPS * strongest


@dataclass(frozen=True)
class Packed:
    """Columns of bytes, one after the other, and what they mean."""

    content: bytes
    """Deflated; `viewer_page/unpack.js` has the order of the columns."""
    about: dict[str, Any]
    """How many Gaussians there are, and the range of each kind of number."""


def pack(splats: Splats, base: Splats, *, sh_degree: int, level: int = 9) -> Packed:
    """Pack what shows of splats, sorted by place, and how it was before.

    `base` holds the first of the splats, with other colours and opacities; the rest was not there.
    The level is zlib's.
    """
    new = splats[len(base) :]
    before = Splats.cat([base, replace(new, opacities=torch.full_like(new.opacities, UNSEEN))])
    shown = torch.maximum(splats.opacities, before.opacities)
    rows = (torch.sigmoid(shown) >= MIN_ALPHA).nonzero()[:, 0]
    rows = rows[morton_order(splats.means[rows])]
    splats, before = splats[rows], before[rows]
    degree = min(sh_degree, max(needed_degree(splats), needed_degree(before)))
    splats, before = of_degree(splats, degree), of_degree(before, degree)
    painted = torch.zeros(len(splats), dtype=torch.bool)
    for name in ("sh0", "shN", "opacities"):
        differs = splats.tensors()[name] != before.tensors()[name]
        painted |= differs[:, None].flatten(1).any(dim=1)
    before = before[painted]
    about: dict[str, Any] = {"count": len(splats), "painted": len(before)}
    about |= {"bands": splats.shN.shape[1], "antialiased": splats.antialiased}
    columns = [*_shapes(splats, about), *_looks(splats, before, painted, about)]
    columns += _bands(splats, before, about)
    content = b"".join(column.contiguous().numpy().tobytes() for column in columns)
    return Packed(zlib.compress(content, level), about)


def _shapes(splats: Splats, about: dict[str, Any]) -> Iterator[Column]:
    means = splats.means.double()
    middle = means.median(dim=0).values
    reach = (means - middle).abs().median().clamp(min=WEB_TINY)
    places = torch.asinh((means - middle) / reach)  # finest in the middle, all the way out
    low, high = places.amin(dim=0), places.amax(dim=0)
    about |= {"middle": middle.tolist(), "reach": float(reach)}
    about["means"] = torch.stack([low, high], dim=1).tolist()
    steps = ((places - low) / (high - low).clamp(min=WEB_TINY) * 65535).round().int()
    yield torch.stack([steps >> 8, steps & 255]).byte().permute(2, 0, 1)  # [3, 2, N]
    scales = splats.scales.clamp(min=WEB_SMALLEST)
    yield _rounded(scales.T, *_range(about, "scales", scales))
    largest, others = smallest_three(splats.quats)  # the largest follows from the others
    yield largest.byte()
    yield _rounded(others.T, -PACKED_LARGEST, PACKED_LARGEST)
    yield _rounded(torch.sigmoid(splats.opacities), 0.0, 1.0)


def _looks(
    splats: Splats, before: Splats, painted: Bool[Tensor, " N"], about: dict[str, Any]
) -> Iterator[Column]:
    after, earlier = (rgb_from_sh0(each.sh0[:, 0]).clamp(*WEB_COLORS) for each in (splats, before))
    bounds = _range(about, "colors", torch.cat([after, earlier]))
    yield _rounded(after.T, *bounds)
    yield painted.byte()
    yield _rounded(earlier.T, *bounds)
    yield _rounded(torch.sigmoid(before.opacities), 0.0, 1.0)


def _bands(splats: Splats, before: Splats, about: dict[str, Any]) -> Iterator[Column]:
    """Two palettes, and what entries Gaussians have in them, after and before."""
    about["strongest"] = [1.0] * WEB_LEVELS
    bands = about["bands"]
    if not bands:
        return
    rest = torch.cat([splats.shN, before.shN]).flatten(1)
    indices = []
    for level in track(range(WEB_LEVELS), "packing colours", unit="palette"):
        palette, strongest, index = palette_of(rest)
        about["strongest"][level] = strongest
        rest = rest - palette_values(palette, strongest)[index]
        indices.append(index.byte())
        yield palette.unflatten(1, (bands, 3)).permute(1, 0, 2)  # [bands, 256, 3]
    for part in (slice(len(splats)), slice(len(splats), None)):
        yield from (index[part] for index in indices)


def _range(about: dict[str, Any], name: str, values: Tensor) -> tuple[float, float]:
    about[name] = [float(values.min()), float(values.max())]
    return about[name][0], about[name][1]


def _rounded(values: Tensor, low: float, high: float) -> Column:
    """As bytes, of which 0 is the lowest value and 255 the highest."""
    return ((values - low) / max(high - low, WEB_TINY) * 255).round().clamp(0, 255).byte()


WEB_PARTS = Path(__file__).with_name("viewer_page")
WEB_SUFFIX = ".html"
MODULAR = re.compile(r"^(import .*\n|export )", re.MULTILINE)  # needless in one script
CODE = ("unpack.js", "sort.js", "draw.js", "camera.js", "hands.js", "main.js")


def write_page(
    what: Scene | Splats, path: Path, *, overwrite: bool = False, sh_degree: int | None = None
) -> None:
    """Write the page of `page_of`, called like its file."""
    degree = MAX_DEGREE if sh_degree is None else sh_degree
    check_choice(degree, "degree of colour", range(MAX_DEGREE + 1))
    refuse_file(path, overwrite=overwrite)
    page = page_of(what, title=path.stem, sh_degree=degree)
    write_file(path, page)
    say_left_out(what.splats if isinstance(what, Scene) else what, path)


def page_of(what: Scene | Splats, *, title: str, sh_degree: int = MAX_DEGREE) -> str:
    """A page that shows splats, from the first photo or from where all is in sight.

    Of a scene that is painted, a handle lies between before and after; buttons bring each object
    into sight. Colours depend on the direction of view up to `sh_degree`, 0 to 3.
    """
    scene = what if isinstance(what, Scene) else None
    splats = (what.splats if isinstance(what, Scene) else what).detach().to("cpu")
    if not (torch.sigmoid(splats.opacities) >= MIN_ALPHA).any():
        raise StyleSplatError("No Gaussian shows, so a page would be black. Choose another scene.")
    base = scene.base.detach().to("cpu") if scene else splats
    packed = pack(splats, base, sh_degree=sh_degree)
    about = packed.about | {
        "start": start_of(splats, scene.cameras if scene else None),
        "objects": list(_objects(scene)) if scene else [],
    }
    return _filled(
        {
            "title": escape(title),
            "about": json.dumps(about).replace("<", r"\u003c"),
            "splats": b64encode(packed.content).decode(),
            "code": "\n".join(MODULAR.sub("", _part(name)) for name in CODE),
        }
    )


def start_of(splats: Splats, cameras: Cameras | None) -> dict[str, Any]:
    """The first view as `camera.js` takes it."""
    view = first_view(splats, cameras)
    places = {"position": view.position, "target": view.target, "up": view.up}
    return {name: place.tolist() for name, place in places.items()} | {"slopes": view.slopes}


def _objects(scene: Scene) -> Iterator[dict[str, Any]]:
    """What objects are called, and where they are."""
    painted = {layer.object: layer.covered(len(scene.base)) for layer in scene.layers}
    named = {name: each.mask for name, each in scene.objects.items()}
    for name, mask in {**painted, **named}.items():
        if mask.any():
            extent = extent_of(scene.base, mask)
            place = {"centre": extent.centre.tolist(), "sides": extent.size.tolist()}
            yield {"name": name, **place, "painted": name in painted}


def _filled(values: dict[str, str]) -> str:
    """The page, with values or files in the place of names between @ and @."""

    def value(found: re.Match[str]) -> str:
        return values[found[1]] if found[1] in values else _part(found[1])

    return re.sub(r"@([\w.]+)@", value, _part("page.html"))


def _part(name: str) -> str:
    return (WEB_PARTS / name).read_text(encoding="utf-8")
