"""Which views several scenes have in common."""

import math
from collections.abc import Mapping

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.scene import Scene

TURNED = 5.0  # degrees between what two scenes say of the same views: refined poses differ by less


def shared_views(scenes: Mapping[str, Scene]) -> tuple[str, ...]:
    """The photos that all scenes have views of: those held out in all, or else any.

    Args:
        scenes: By what they are called; their world frames may differ.

    Returns:
        Names in the first scene's order.

    Raises:
        StyleSplatError: If there are none, or views of a name are of other photos: of another
            size, or turned otherwise against each other.
    """
    (first, one), *others = scenes.items()
    for name, scene in others:
        common = [view for view in one.cameras.names if view in {*scene.cameras.names}]
        if not common:
            raise StyleSplatError(
                f"{first} and {name} share no view: {one.cameras.names[0]} is one of the first, "
                f"{scene.cameras.names[0]} of the other. Compare scenes of the same photos."
            )
        _refuse_others(first, one.cameras[_rows(one.cameras, common)], name, scene.cameras)
    every = [{*scene.cameras.names} for scene in scenes.values()]
    held_out = [{*scene.held_out} for scene in scenes.values()]
    shared = set[str].intersection(*every)
    if not shared:
        raise StyleSplatError(
            f"No view is in all of {', '.join(scenes)}. Compare scenes of the same photos."
        )
    unseen = shared.intersection(*held_out)
    return tuple(name for name in one.cameras.names if name in (unseen or shared))


def _refuse_others(first: str, one: Cameras, name: str, cameras: Cameras) -> None:
    """Raise a StyleSplatError if views of the same names are of other photos."""
    other = cameras[_rows(cameras, one.names)]
    differ = (one.sizes != other.sizes).any(dim=1)
    if differ.any():
        row = int(differ.nonzero()[0])
        sizes = (f"{w}x{h}" for w, h in (one.sizes[row].tolist(), other.sizes[row].tolist()))
        raise StyleSplatError(
            f"{one.names[row]} is {next(sizes)} pixels in {first} and {next(sizes)} in {name}. "
            "Compare scenes of the same photos."
        )
    angle = _turned(one, other)
    if angle > TURNED:
        raise StyleSplatError(
            f"The views of {first} and {name} have the same names, but look elsewhere (by "
            f"{angle:.0f} degrees). Compare scenes of the same photos."
        )


def _turned(one: Cameras, other: Cameras) -> float:
    """Degrees by which views are turned otherwise against the first one; the median."""
    relative = [c.viewmats[:, :3, :3].cpu() @ c.viewmats[:1, :3, :3].cpu().mT for c in (one, other)]
    traces = torch.einsum("cij,cij->c", *relative)
    angles = ((traces - 1) / 2).clamp(-1, 1).acos()
    return math.degrees(float(angles.median()))


def _rows(cameras: Cameras, names: "tuple[str, ...] | list[str]") -> list[int]:
    places = {name: row for row, name in enumerate(cameras.names)}
    return [places[name] for name in names]
