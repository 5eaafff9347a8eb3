"""`sheet`: one object in a grid of styles and settings, to choose from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.argument_kinds import check_arguments
from stylesplat.figures.best_views import close_up
from stylesplat.figures.grid import draw_grid
from stylesplat.figures.pictures import to_uint8
from stylesplat.figures.style_sheet import caption_rows, plan_sheet
from stylesplat.progress import track
from stylesplat.rendering.render import pick_device, render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.compose import with_strengths
from stylesplat.scene.one_line import counted, one_line
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.selection.choose import find_object
from stylesplat.stylization.config import Network
from stylesplat.stylization.paint import check_targets
from stylesplat.stylization.style_image import Picture
from stylesplat.stylization.target import PaintTarget
from stylesplat.verbs.stylize import stylize

CELL = 512  # pixels along a cell: strokes of a normal painting can be told apart


@dataclass(frozen=True)
class StyleSheet:
    """An object in a grid."""

    picture: UInt8[Tensor, "H W 3"]
    """The grid."""
    view: str
    """The photo that it is looked at from."""
    cells: int
    """Number of cells, without the object as it is."""
    repainted: int
    """Number of cells that were painted; the others are blends of these."""

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
) -> StyleSheet:
    """Repaint an object once for each cell, as `stylize` does, and draw the results.

    Cells that differ in nothing but intensity are blends of one result.

    Args:
        scene: Where the object is.
        name: The object.
        styles: Pictures, or several that make one style; alternatives are rows.
        vary: Settings, named as options of `stylize`, and the values to try: the first makes
            columns, a second rows.
        view: The photo to look from; by default the one that shows most of the object.
        features: Network whose features are matched; by default that of the preset.
        weights: File of its weights.
        device: Where to compute.
        settings: Of all cells, such as `steps=150`, and their `preset`.

    Raises:
        StyleSplatError: If the object, a picture, the view or the weights file is unfit, or there
            is more than rows and columns can show.

    Example:
        >>> sheet(scene, "vase", ["wave.jpg"], vary={"stroke_size": (1, 2, 4)})  # doctest: +SKIP
    """
    several = [(s,) if isinstance(s, str | Path | Tensor) else tuple(s) for s in styles]
    variations = [(key, tuple(values)) for key, values in (vary or {}).items()]
    plan = plan_sheet(several, variations, settings=settings)
    runs, picked = plan.runs(), find_object(scene, name)
    jobs = [PaintTarget(name, picked, style.read(), style.config) for style, _ in runs]
    check_targets(jobs[:1])
    splats = scene.splats.to(pick_device(device))
    cameras = scene.cameras if view is None else scene.cameras[scene.cameras.index(view)]
    camera = close_up(splats, cameras, picked.to(splats.device), side=CELL)
    # The paint that the object has stays in its place of the stack, without a message about it
    bare = replace(with_strengths(scene, {name: 0.0}), path=scene.path)
    how = {"features": features, "weights": weights, "device": device, "measured": False}
    pictures = {}
    for style, cells in track(runs, name, unit="painting"):
        painted = stylize(bare, {name: style}, **how)
        for cell in cells:
            intensity = {name: cell.style.config.intensity}
            blended = with_strengths(painted, intensity).splats.to(splats.device)
            pictures[cell.row, cell.column] = _picture(blended, camera)
    grid = draw_grid(caption_rows(plan, pictures, _picture(splats, camera)))
    return StyleSheet(grid, camera.names[0], len(pictures), len(runs))


@torch.no_grad()
def _picture(splats: Splats, camera: Cameras) -> UInt8[Tensor, "_ _ 3"]:
    return to_uint8(render(splats, camera)[0]).cpu()
