"""Measurements in words, and the differences between those of several scenes."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeGuard

SUMMARY_VISIBLE = 0.5 / 255  # of 1: what is less is the same in a picture of 8 bits
BARE = 0.01  # of an object, from which it is said to be left bare: of six subjects .004 at most is
MUCH = 0.1  # of an object in colours that are not the painting's: more than specks and blends
SUMMARY_WHOLE = "as close to the painting as the painting's parts are to each other"


def style_lines(metrics: Mapping[str, Any], names: Iterable[str]) -> list[str]:
    """Say how close each painted object is to its style, and what else changed."""
    lines = []
    for name in names:
        share, own, foreign, bare = (
            metrics.get(number, {}).get(name)
            for number in ("share_of_way", "nnfm_of_style", "off_palette", "bare")
        )
        way = "painted"  # it was as close before, or the style is too small to tell
        if own is not None and metrics["nnfm_after"][name] <= own:
            way = SUMMARY_WHOLE
        elif share is not None:
            way = f"{min(99, round(100 * share))} % of the way to the painting"
        if foreign is not None and foreign > MUCH:
            way += f", {round(100 * foreign)} % of it in colours that the painting does not have"
        if bare is not None and bare > BARE:
            way += f", {round(100 * bare)} % of it without paint"
        lines.append(f"{name}: {way}")
    rest = describe_changes(metrics, count=len(lines))
    if len(lines) == 1:
        return [f"{lines[0]}, {rest}."]
    return [*(f"{line}." for line in lines), f"{rest[:1].upper()}{rest[1:]}."]


def photo_lines(metrics: Mapping[str, Any]) -> list[str]:
    """Say how close renders are to photos, and labels to label maps, by `evaluate_views`."""
    lines = []
    if {"psnr", "ssim"} <= metrics.keys():
        close = f"PSNR {metrics['psnr']:.2f} dB, SSIM {metrics['ssim']:.3f}"
        if "object_psnr" in metrics:
            close += f"; over the object alone PSNR {metrics['object_psnr']:.2f} dB"
        lines.append(f"Renders against photos: {close}.")
    if "miou" in metrics:
        objects = f"IoU {metrics['miou']:.2f}, of their borders {metrics['boundary_miou']:.2f}"
        lines.append(f"Objects against label maps: {objects}, on average.")
    return lines


def describe_changes(metrics: Mapping[str, Any], *, count: int = 1) -> str:
    """Say what changed besides so many painted objects."""
    changed, largest = metrics["changed_outside"], metrics["outside_max_difference"]
    if changed:
        return f"{changed:,} Gaussians outside changed as well"
    if metrics.get("stain_pixels"):
        beside = "beside the object" if count == 1 else "beside the objects"
        stain = f"a stain of {metrics['stain_pixels']:,} pixels {beside}"
        return f"{stain} in view {metrics['stain_view']}"
    if largest >= SUMMARY_VISIBLE:
        levels = max(1, round(255 * largest))
        return f"no other Gaussian changed, pixels beside by {levels} of 255 levels at most"
    return "nothing else changed" if "stain_pixels" in metrics else "no other Gaussian changed"


def painted_gaussians(metrics: Mapping[str, Any], total: int) -> str:
    """Say how many of the `total` Gaussians before were painted, and how many a canvas added."""
    painted = metrics["painted_gaussians"]
    after = metrics["changed_gaussians"] - metrics["changed_outside"]
    canvas = f", and a canvas of {after - painted:,}" if after > painted else ""
    return f"{painted:,} of {total:,}{canvas}"


def metric_differences(metrics: Mapping[Any, Any], first: Mapping[Any, Any]) -> dict[Any, Any]:
    """Subtract nested numbers; names that one of both lacks are left out.

    Example:
        >>> first = {"psnr": 30.0, "iou": {"1": 0.75}}
        >>> metric_differences({"psnr": 31.0, "iou": {"1": 0.5}}, first)
        {'psnr': 1.0, 'iou': {'1': -0.25}}
    """
    found: dict[Any, Any] = {}
    for name, value in metrics.items():
        other = first.get(name)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            found[name] = metric_differences(value, other)
        elif _is_number(value) and _is_number(other):
            found[name] = value - other
    return found


def flat(metrics: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    """Nested numbers with one name each.

    Example:
        >>> [*flat({"psnr": 31.0, "iou": {"vase": 0.5}, "text": "left out"})]
        [('psnr', 31.0), ('iou vase', 0.5)]
    """
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name} ")
        elif _is_number(value):
            yield f"{prefix}{name}", value


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
