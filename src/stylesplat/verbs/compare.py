"""`compare`: scenes side by side, in pictures and in the numbers of `evaluate`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.summary import metric_differences
from stylesplat.figures.html_page import SceneColumn
from stylesplat.figures.pictures import render_pictures
from stylesplat.metrics.images import ssim
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device
from stylesplat.scene.capture import Capture
from stylesplat.scene.one_line import counted, one_line
from stylesplat.scene.sampling import evenly
from stylesplat.scene.scene import Scene, shared_views
from stylesplat.verbs.evaluate import evaluate

VIEWS = 4  # by default
VISIBLE = 8  # levels of 255 in a channel: smaller differences are hard to see
LONGEST = 960  # pixels of a picture's side
SCHEMA = "stylesplat-comparison-1"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Scenes side by side; the first is what others are compared with."""

    views: tuple[str, ...]
    """The photos' names of the pictures."""
    scenes: tuple[SceneColumn, ...]
    """In the order in which they were given."""
    notes: tuple[str, ...] = ()
    """What makes numbers less comparable, in sentences."""

    def __repr__(self) -> str:
        names = ", ".join(each.name for each in self.scenes)
        return one_line(self, names, counted(len(self.views), "view"))

    def summary(self) -> dict[str, Any]:
        """All but the pictures as plain values, for JSON."""
        fields = ("name", "metrics", "differences", "from_first")
        scenes = [
            {"path": each.scene.path, "gaussians": len(each.scene.splats)}
            | {name: getattr(each, name) for name in fields}
            for each in self.scenes
        ]
        return {"schema": SCHEMA, "views": self.views, "scenes": scenes, "notes": self.notes}


@check_arguments
@torch.no_grad()
def compare(
    scenes: Mapping[str, Scene],
    captures: Mapping[str, Capture] | None = None,
    *,
    views: int = VIEWS,
    device: str = "auto",
) -> Comparison:
    """Put scenes of the same photos side by side.

    Args:
        scenes: By what they are to be called, at least two; the first is what others are
            compared with. Their world frames may differ.
        captures: The photos of each, as `evaluate` takes them; of those that have none, only a
            style is measured.
        views: How many pictures of each, of views held out in all scenes if there are any.
        device: Where to render.

    Returns:
        Pictures and numbers. What cannot be measured of a scene is said, and noted.

    Raises:
        StyleSplatError: If there are fewer than two scenes, or they share no view.
    """
    if len(scenes) < 2:
        raise StyleSplatError(f"Expected at least two scenes to compare, got {len(scenes)}.")
    names = tuple(evenly(shared_views(scenes), max(1, views)))
    (first, one), *others = scenes.items()
    notes = [
        f"{name} holds out other photos than {first}: their numbers are of different photos."
        for name, scene in others
        if {*scene.held_out} != {*one.held_out}
    ]
    found = list[SceneColumn]()
    for name, scene in scenes.items():
        metrics: dict[str, Any] = {}
        try:
            metrics = evaluate(scene, (captures or {}).get(name), device=device)
        except StyleSplatError as error:  # pictures of it can be compared
            notes.append(f"{name} has no numbers: {error}")
        cameras = scene.cameras[[*map(scene.cameras.names.index, names)]]
        splats = scene.splats.to(pick_device(device))
        each = (render_pictures(splats, camera.at_most(LONGEST)) for camera in cameras)
        pictures = tuple(picture for (picture,) in each)
        base = found[0] if found else None
        differences = metric_differences(metrics, base.metrics if base else metrics)
        from_first = picture_differences(pictures, base.pictures if base else pictures)
        found.append(SceneColumn(name, scene, metrics, differences, from_first, pictures))
    for note in notes:
        say(note)
    return Comparison(names, tuple(found), tuple(notes))


def picture_differences(
    pictures: Sequence[UInt8[Tensor, "_ _ 3"]], first: Sequence[UInt8[Tensor, "_ _ 3"]]
) -> dict[str, float]:
    """Differences of pictures to others of the same views, which are 0 for equal pictures.

    Returns `mean_difference` and `largest_difference` of a channel, in 0..1; `changed_share`, the
    share of pixels of which a channel differs by more than 8 of 255 levels; and `ssim_lost`,
    1 - SSIM. All but the largest are means over the views.
    """
    pairs = [(a.float() / 255, b.float() / 255) for a, b in zip(pictures, first, strict=True)]
    gaps = [(a - b).abs() for a, b in pairs]
    return {
        "mean_difference": fmean(float(gap.mean()) for gap in gaps),
        "largest_difference": max(float(gap.max()) for gap in gaps),
        "changed_share": fmean(
            float((gap.amax(dim=-1) > VISIBLE / 255).float().mean()) for gap in gaps
        ),
        "ssim_lost": fmean(max(0.0, 1 - float(ssim(a, b))) for a, b in pairs),
    }
