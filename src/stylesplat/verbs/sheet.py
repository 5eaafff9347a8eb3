"""`sheet`: one object in a grid of styles and settings, to choose from."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.argument_kinds import check_arguments
from stylesplat.figures.compositing import to_uint8
from stylesplat.figures.grid import draw_grid
from stylesplat.figures.object_sheet import close_up
from stylesplat.figures.style_sheet import SheetPlan, captioned, plan_sheet
from stylesplat.progress import track
from stylesplat.rendering.device import pick_device
from stylesplat.rendering.one_view import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.compose import with_strengths
from stylesplat.scene.one_line import counted, one_line
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.selection.choose import find_object
from stylesplat.stylization.config import Network
from stylesplat.stylization.paint import check_targets
from stylesplat.stylization.style import Picture, Style
from stylesplat.stylization.target import PaintTarget
from stylesplat.verbs.stylize import stylize_unmeasured

Drawn = UInt8[Tensor, "_ _ 3"]


@dataclass(frozen=True)
class Sheet:
    """An object in a grid."""

    picture: UInt8[Tensor, "H W 3"]
    """The grid."""
    view: str
    """The photo that it is looked at from."""
    cells: int
    """How many there are, the object as it is aside."""
    repainted: int
    """How many of them were painted; the others are blends of these."""

    def __repr__(self) -> str:
        height, width, _ = self.picture.shape
        return one_line(self, counted(self.cells, "cell"), f"{width}x{height}", f"from {self.view}")


@check_arguments
def sheet(
    scene: Scene,
    name: str,
    styles: Sequence[Picture | Sequence[Picture]],
    *,
    vary: Mapping[str, Sequence[Any]] | None = None,
    view: str | None = None,
    features: Network | None = None,
    weights: Path | str | None = None,
    device: str = "auto",
    **settings: Any,
) -> Sheet:
    """Repaint an object once for each cell, as `stylize` would, and draw the results.

    Cells that differ in nothing but intensity are blends of one result.

    Args:
        scene: Where the object is.
        name: The object.
        styles: Pictures, or several that make one style; alternatives are rows.
        vary: Settings, or `preset`, and the values to try: the first makes columns, a second rows.
        view: The photo to look from; by default the one that shows most of the object.
        features: Network whose features are matched; by default that of the preset.
        weights: File of its weights.
        device: Where to compute.
        settings: Of all cells, such as `steps=150`, and their `preset`.

    Raises:
        StyleSplatError: If the object, a picture, the view or the weights file is unfit, or there
            is more than rows and columns can show.

    Example:
        >>> sheet(scene, "vase", ["wave.jpg"], vary={"scale": (1, 2, 4)})  # doctest: +SKIP
    """
    several = [(s,) if isinstance(s, str | Path | Tensor) else tuple(s) for s in styles]
    variations = [(key, tuple(values)) for key, values in (vary or {}).items()]
    plan = plan_sheet(several, variations, settings=settings)
    how = {"features": features, "weights": weights, "device": device}

    def painted() -> Iterator[Scene]:
        # Its own paint is not told of, and stays in its place of the stack
        bare = replace(with_strengths(scene, {name: 0.0}), path=scene.path)
        for style, _ in track(plan.runs(), name, unit="painting"):
            yield stylize_unmeasured(bare, {name: style}, **how).scene

    return sheet_of(scene, name, plan, painted(), view=view, device=device)


def sheet_of(
    scene: Scene,
    name: str,
    plan: SheetPlan,
    painted: Iterable[Scene],
    *,
    view: str | None = None,
    device: str = "auto",
) -> Sheet:
    """As `sheet`, of what was painted elsewhere.

    Args:
        scene: Where the object is.
        name: The object.
        plan: What to draw.
        painted: The scene with each of `plan.runs()` painted; asked for when all is checked.
        view: The photo to look from; by default the one that shows most of the object.
        device: Where to draw.

    Raises:
        StyleSplatError: As `sheet` does.
    """
    runs = plan.runs()
    splats, camera = _looked(scene, name, runs, view, device)
    pictures = {}
    for (_, places), each in zip(runs, painted, strict=True):
        for place in places:
            shown = with_strengths(each, {name: place.intensity}).splats.to(splats.device)
            pictures[place.row, place.column] = _picture(shown, camera)
    grid = draw_grid(captioned(plan, pictures, _picture(splats, camera)))
    return Sheet(grid, camera.names[0], len(pictures), len(runs))


def _looked(
    scene: Scene, name: str, runs: Sequence[tuple[Style, Any]], view: str | None, device: str
) -> tuple[Splats, Cameras]:
    """What a sheet shows an object with, and from where; it and its styles are checked."""
    picked = find_object(scene, name)
    jobs = [PaintTarget(name, picked, style.read(), style.config) for style, _ in runs]
    check_targets(jobs[:1])
    splats = scene.splats.to(pick_device(device))
    cameras = scene.cameras if view is None else scene.cameras[scene.cameras.index(view)]
    return splats, close_up(splats, cameras, picked.to(splats.device))


@torch.no_grad()
def _picture(splats: Splats, camera: Cameras) -> Drawn:
    return to_uint8(render(splats, camera)[0]).cpu()
