"""The `Splats` noun: a set of 3D Gaussians with their objects; the basis of their colours."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, noun_repr
from stylesplat.options import check_arguments
from stylesplat.scene.world_offset import ORIGIN, Offset, from_world, to_world

LUMA = (0.2126, 0.7152, 0.0722)  # Rec. 709: how bright red, green and blue are
SH_C0 = 0.28209479177387814  # sqrt(1 / 4 pi): value of the constant band of colour
SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658)
SH_C3_ZONAL = (0.3731763325901154, 1.445305721320277)
IDENTITY_SIZE = 16  # numbers per Gaussian that encode its object (Gaussian Grouping)
UNIT_ERROR = 1e-6  # of the norm of a quaternion that counts as 1
OPACITY_END = 2.0**-53  # of 0 and 1: the last below 1 in 64 bits, a logit of 37
AT_ONCE = 1 << 22  # scores: 16 MB, while those of all Gaussians by all labels may be 40 GB


@dataclass(frozen=True, eq=False)
class Classifier:
    """Linear decoder from identities to the label ids of a capture."""

    weight: Float[Tensor, "K 16"]
    """One row per class."""
    bias: Float[Tensor, " K"]
    """One number per class."""
    ids: tuple[int, ...]
    """The user's label id of each class; 0 is background."""

    def __repr__(self) -> str:
        return noun_repr(self, f"label ids {' '.join(map(str, self.ids))}")

    def logits(self, identities: Float[Tensor, "*B 16"]) -> Float[Tensor, "*B K"]:
        """Class scores before the softmax, one column per entry of `ids`."""
        return identities @ self.weight.T + self.bias

    def some_at_a_time(
        self, identities: Float[Tensor, "N 16"]
    ) -> Iterator[tuple[slice, Float[Tensor, "B K"]]]:
        """The logits of a few rows at a time, as a table of all rows may be too large."""
        size = max(1, AT_ONCE // len(self.ids))
        for first in range(0, max(len(identities), 1), size):
            rows = slice(first, min(first + size, len(identities)))
            yield rows, self.logits(identities[rows])

    def likeliest(self, identities: Float[Tensor, "*B 16"]) -> Int[Tensor, "*B"]:
        """The label id of the highest score."""
        flat = identities.flatten(0, -2)
        classes = [scores.argmax(dim=-1) for _, scores in self.some_at_a_time(flat)]
        known = torch.tensor(self.ids, device=identities.device)
        return known[torch.cat(classes)].unflatten(0, identities.shape[:-1])

    def to(self, device: torch.device | str) -> "Classifier":
        """The same classifier on another device."""
        return replace(self, weight=self.weight.to(device), bias=self.bias.to(device))


@dataclass(frozen=True, eq=False)
class Splats:
    """N Gaussians as they are stored: scales are log, opacities logit, quats any norm.

    The spherical harmonics follow gsplat: `sh0` is the constant band, `shN` the others, in the
    order of the INRIA code. Colour is `0.5 + sum(sh * basis)`, clamped at 0.
    """

    means: Float[Tensor, "N 3"]
    """Centres in the capture's world frame, relative to `world_offset`."""
    quats: Float[Tensor, "N 4"]
    """Rotations, wxyz."""
    scales: Float[Tensor, "N 3"]
    """Logarithms of the standard deviations along the axes."""
    opacities: Float[Tensor, " N"]
    """Logits."""
    sh0: Float[Tensor, "N 1 3"]
    """Constant colour band."""
    shN: Float[Tensor, "N _ 3"]
    """Higher colour bands: 0, 3, 8 or 15 of them."""
    identities: Float[Tensor, "N 16"] | None = None
    """The object that each Gaussian belongs to, decoded by `classifier`."""
    classifier: Classifier | None = None
    """Decoder of `identities`; None without label maps."""
    confidence: Float[Tensor, " N"] | None = None
    """The share of a Gaussian's pixels that have its label, 0 if no label map shows it; None if
    identities were not lifted from label maps."""
    antialiased: bool = False
    """Whether opacities are those of a renderer that scales them by how much its blur of 0.3 pixels
    enlarges a Gaussian's footprint (Mip-Splatting; gsplat's `antialiased` mode)."""
    world_offset: Offset = ORIGIN
    """What was subtracted from the world's coordinates, which may be too large for float32."""

    def __repr__(self) -> str:
        return noun_repr(
            self,
            count_noun(len(self), "Gaussian"),
            f"SH degree {self.sh_degree}",
            "antialiased" if self.antialiased else None,
            None if self.identities is None else "with identities",
            None if self.device.type == "cpu" else self.device,
        )

    def __len__(self) -> int:
        return self.means.shape[0]

    def __getitem__(self, index: slice | Bool[Tensor, " N"] | Int[Tensor, " M"]) -> "Splats":
        if isinstance(index, Tensor) and index.dtype == torch.bool:
            index = index.nonzero()[:, 0]  # once, as a GPU's host waits to hear their number
        return self.map(lambda tensor: tensor[index])

    def map(self, function: Callable[[Tensor], Tensor]) -> "Splats":
        """The splats with a function applied to each per-Gaussian tensor."""
        return replace(self, **{name: function(t) for name, t in self.tensors().items()})

    @staticmethod
    def cat(parts: "Sequence[Splats]") -> "Splats":
        """The Gaussians of splats that have the same fields; the classifier is the first's.

        Raises:
            StyleSplatError: If some are antialiased and others are not.
        """
        parts = [part for part in parts if len(part)] or parts[:1]
        if len({part.antialiased for part in parts}) > 1:
            raise StyleSplatError(
                "Cannot join anti-aliased Gaussians with others: a picture has one mode. Join "
                "splats that were trained in the same mode."
            )
        every = [part.tensors() for part in parts]
        tensors = {name: torch.cat([each[name] for each in every]) for name in every[0]}
        return replace(parts[0], **tensors)

    @property
    def device(self) -> torch.device:
        """Where the tensors live."""
        return self.means.device

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics stored, 0 to 3."""
        return int((self.shN.shape[1] + 1) ** 0.5) - 1

    def tensors(self) -> dict[str, Tensor]:
        """The per-Gaussian tensors that are present, by field name."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, Tensor)}

    def with_rows(self, rows: Int[Tensor, " M"], tensors: Mapping[str, Tensor]) -> "Splats":
        """The splats with other values in some rows, by field name; gradients reach the values."""
        every = self.tensors()
        changed = {name: every[name].index_copy(0, rows, part) for name, part in tensors.items()}
        return replace(self, **changed)

    def to(self, device: torch.device | str) -> "Splats":
        """The same splats on another device; themselves if they are there."""
        tensors = [*self.tensors().values()]
        tensors += [self.classifier.weight, self.classifier.bias] if self.classifier else []
        if {tensor.device for tensor in tensors} == {torch.device(device)}:
            return self
        classifier = self.classifier.to(device) if self.classifier else None
        return replace(self.map(lambda tensor: tensor.to(device)), classifier=classifier)

    def relative_to(self, offset: Offset) -> "Splats":
        """The same Gaussians in the world, with another `world_offset`."""
        if offset == self.world_offset:
            return self
        means = from_world(to_world(self.means, self.world_offset), offset).to(self.means)
        return replace(self, means=means, world_offset=offset)

    def detach(self) -> "Splats":
        """The same values, cut from any autograd graph."""
        return self.map(Tensor.detach)

    def activated(self) -> "ActivatedGaussians":
        """The values that renderers of other programs take, as `from_gaussians` has them.

        They are computed in 64 bits and rounded to the type of the tensors once. So float32 keeps
        scales to 6e-8 of their size and opacities to 6e-8; for a round trip to the bit ask in 64
        bits: `splats.map(torch.Tensor.double).activated()`.

        Returns:
            Means in world units, relative to `world_offset`; quaternions of norm 1, wxyz; standard
            deviations along the axes in world units; opacities in 0..1; spherical harmonics.
        """
        norms = self.quats.double().norm(dim=1, keepdim=True)
        is_unit = (norms - 1).abs() < UNIT_ERROR  # stays, to the bit
        return ActivatedGaussians(
            self.means,
            torch.where(is_unit, self.quats, (self.quats / norms).to(self.quats)),
            self.scales.double().exp().to(self.scales),
            self.opacities.double().sigmoid().to(self.opacities),
            torch.cat([self.sh0, self.shN], dim=1),
        )


class ActivatedGaussians(NamedTuple):
    """N Gaussians as renderers take them: scales and opacities are activated."""

    means: Float[Tensor, "N 3"]
    """Centres, in world units."""
    quats: Float[Tensor, "N 4"]
    """Rotations, wxyz."""
    scales: Float[Tensor, "N 3"]
    """Standard deviations along the axes, in world units."""
    opacities: Float[Tensor, " N"]
    """In 0..1."""
    sh: Float[Tensor, "N K 3"]
    """Spherical harmonics of the colours: 1, 4, 9 or 16 bands, the constant one first."""


@check_arguments
def from_gaussians(
    means: Tensor | np.ndarray,
    quats: Tensor | np.ndarray,
    scales: Tensor | np.ndarray,
    opacities: Tensor | np.ndarray,
    sh: Tensor | np.ndarray,
) -> Splats:
    """Splats of the values that another program renders: `Splats.activated` gives them back.

    Args:
        means: [N, 3] centres, in world units.
        quats: [N, 4] rotations, wxyz, of any norm but 0.
        scales: [N, 3] standard deviations along the axes, in world units: not logarithms.
        opacities: [N] or [N, 1], in 0..1: not logits. 0 and 1 become the nearest values between.
        sh: [N, K, 3] spherical harmonics in the order of the INRIA code, K = 1, 4, 9 or 16 bands,
            the constant one first. `(rgb - 0.5) / 0.28209479177387814` is that of a colour.

    Returns:
        Splats in float32, on the device of `means`.

    Raises:
        StyleSplatError: If shapes do not belong together, a number is not finite, a scale is not
            positive, a quaternion is 0 or an opacity lies outside of 0..1.
    """
    device = means.device if isinstance(means, Tensor) else torch.device("cpu")
    given = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "sh": sh}
    values = {name: _numbers(name, each).to(device) for name, each in given.items()}
    if values["opacities"].ndim == 2:
        values["opacities"] = values["opacities"].flatten()
    shapes = {name: tuple(each.shape) for name, each in values.items()}
    count = len(values["means"]) if values["means"].ndim else 0
    wanted = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": ()}
    fits = all(shapes[name] == (count, *tail) for name, tail in wanted.items())
    if not fits or len(shapes["sh"]) != 3 or shapes["sh"][::2] != (count, 3):
        listed = ", ".join(f"{name} {list(shape)}" for name, shape in shapes.items())
        raise StyleSplatError(
            f"Cannot make splats of {listed}. Give means [N, 3], quats [N, 4], scales [N, 3], "
            "opacities [N] and sh [N, K, 3]."
        )
    if shapes["sh"][1] not in map(sh_bases, range(4)):
        raise StyleSplatError(
            f"Spherical harmonics of {shapes['sh'][1]} bands have no degree. Give 1, 4, 9 or 16."
        )
    faults = {
        "scales that are not positive: give standard deviations, not logarithms": (
            values["scales"] <= 0
        ),
        "opacities outside of 0..1: give them after the sigmoid": (
            (values["opacities"] < 0) | (values["opacities"] > 1)
        ),
        "quaternions of norm 0: give rotations": (values["quats"] == 0).all(dim=1),
    }
    for fault, rows in faults.items():
        if number := int(rows.sum()):
            raise StyleSplatError(f"Cannot make splats of {number} {fault}.")
    opacities = values["opacities"].clamp(OPACITY_END, 1 - OPACITY_END)
    return Splats(
        means=values["means"].float(),
        quats=values["quats"].float(),
        scales=values["scales"].log().float(),
        opacities=torch.logit(opacities).float(),
        sh0=values["sh"][:, :1].float(),
        shN=values["sh"][:, 1:].float(),
    )


def _numbers(name: str, values: Tensor | np.ndarray) -> Float[Tensor, "..."]:
    """Finite numbers, in 64 bits."""
    tensor = values.detach() if isinstance(values, Tensor) else torch.from_numpy(values)
    tensor = tensor.double()
    if not tensor.isfinite().all():
        raise StyleSplatError(
            f"Cannot make splats of {name} that are not finite. Remove these Gaussians."
        )
    return tensor


def sh_basis(degree: int, dirs: Float[Tensor, "N 3"]) -> Float[Tensor, "N K"]:
    """Real spherical harmonics of unit vectors, in the order and signs of the INRIA code."""
    x, y, z = dirs.unbind(-1)
    basis = [torch.full_like(x, SH_C0)]
    if degree >= 1:
        basis += [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    if degree >= 2:
        a, b, c = SH_C2
        basis += [a * x * y, -a * y * z, b * (3 * z * z - 1), -a * x * z, c * (x * x - y * y)]
    if degree >= 3:
        a, b, c = SH_C3
        zonal, tesseral = SH_C3_ZONAL
        basis += [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (5 * z * z - 1),
            zonal * z * (5 * z * z - 3),
            -c * x * (5 * z * z - 1),
            tesseral * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ]
    return torch.stack(basis, dim=-1)


def sh_bases(degree: int) -> int:
    """The number of basis functions up to a degree: 1, 4, 9 or 16."""
    return (degree + 1) ** 2


def sh0_from_rgb(rgb: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """The constant band that shows a colour in 0..1 from everywhere."""
    return (rgb - 0.5) / SH_C0


def rgb_from_sh0(sh0: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """The mean colour of a constant band, in 0..1 unless it is out of range."""
    return 0.5 + SH_C0 * sh0


def linear_rgb(colors: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 3"]:
    """Intensities of light, 0 to 1, of sRGB colours (IEC 61966-2-1)."""
    return torch.where(colors > 0.04045, ((colors + 0.055) / 1.055) ** 2.4, colors / 12.92)


def map_bands(
    sh0: Float[Tensor, "N 1 3"], shN: Float[Tensor, "N _ 3"], color_map: Float[Tensor, "3 4"]
) -> tuple[Float[Tensor, "N 1 3"], Float[Tensor, "N _ 3"]]:
    """The bands that show `color_map @ (red, green, blue, 1)` of each colour, from everywhere."""
    matrix, offset = color_map[:, :3], color_map[:, 3]
    shift = sh0_from_rgb(0.5 * matrix.sum(dim=1) + offset)  # zero coefficients show 0.5
    return sh0 @ matrix.T + shift, shN @ matrix.T
