"""How measurements of several scenes differ."""

from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

from jaxtyping import UInt8
from torch import Tensor

from stylesplat.metrics.ssim import ssim

VISIBLE = 8  # levels of 255 in a channel: what differs by less is hard to see


def differences(metrics: Mapping[Any, Any], first: Mapping[Any, Any]) -> dict[Any, Any]:
    """Numbers less those of the first, as deeply nested as both are; what one lacks is left out.

    Example:
        >>> differences({"psnr": 31.0, "iou": {"1": 0.5}}, {"psnr": 30.0, "iou": {"1": 0.75}})
        {'psnr': 1.0, 'iou': {'1': -0.25}}
    """
    found: dict[Any, Any] = {}
    for name, value in metrics.items():
        other = first.get(name)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            found[name] = differences(value, other)
        elif _is_number(value) and _is_number(other):
            found[name] = value - other
    return found


def flat(metrics: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    """Numbers with one name each.

    Example:
        >>> [*flat({"psnr": 31.0, "iou": {"vase": 0.5}, "text": "left out"})]
        [('psnr', 31.0), ('iou vase', 0.5)]
    """
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name} ")
        elif _is_number(value):
            yield f"{prefix}{name}", value


def picture_differences(
    pictures: list[UInt8[Tensor, "_ _ 3"]], first: list[UInt8[Tensor, "_ _ 3"]]
) -> dict[str, float]:
    """How far pictures are from others of the same views; of equal ones all numbers are 0.

    Args:
        pictures: One per view.
        first: As many, each as large as its partner.

    Returns:
        `mean_difference` and `largest_difference` of a channel, in 0..1; `changed_share`, of the
        pixels a channel of which differs by more than 8 of 255 levels; `ssim_lost`, 1 - SSIM. All
        but the largest are means over the views.
    """
    pairs = [(a.float() / 255, b.float() / 255) for a, b in zip(pictures, first, strict=True)]
    gaps = [(a - b).abs() for a, b in pairs]
    count = len(pairs)
    changed = [float((gap.amax(dim=-1) > VISIBLE / 255).float().mean()) for gap in gaps]
    return {
        "mean_difference": sum(float(gap.mean()) for gap in gaps) / count,
        "largest_difference": max(float(gap.max()) for gap in gaps),
        "changed_share": sum(changed) / count,
        "ssim_lost": sum(max(0.0, 1 - float(ssim(a, b))) for a, b in pairs) / count,
    }


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
