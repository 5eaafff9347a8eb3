"""Brushes on layers: what is drawn on the picture changes the scene."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun
from stylesplat.rendering.weights import COVERED, coverage, expected_depth
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import Layer
from stylesplat.scene.projection import unproject
from stylesplat.scene.scene import Scene
from stylesplat.scene.world_offset import to_world
from stylesplat.studio_app import edits as layers
from stylesplat.studio_app import messages as m
from stylesplat.studio_app import selecting as picking
from stylesplat.studio_app.history import StudioState
from stylesplat.studio_app.paint_queue import PaintQueue
from stylesplat.studio_app.pictures import Pictures
from stylesplat.studio_app.reports import layer_title

LEAST_TOUCH = 0.02  # of a Gaussian, by which a brush touches it
MOST_GUIDES, GUIDE_PLACES = 60, 24  # lines of a layer, and places of a line


class Brushes:
    def __init__(self, pictures: Pictures, queue: PaintQueue) -> None:
        self.session, self.pictures, self.queue = pictures.session, pictures, queue

    def mask_drawn(
        self,
        name: m.ShortText,
        points: m.DrawnLine,
        shows: bool,
        radius: m.Share = 0.03,
        soft: m.Share = 0.5,
    ) -> StudioState:
        """Paint a layer in or out by a brush, whose edge is as soft as that share of its radius."""
        state, camera = self.session.state, self.pictures.camera()
        rows = layers.find_layer(state.scene, name).covered(len(state.scene.base))
        region = picking.soft_brush(points, camera.size, radius, soft)
        weights = picking.brushed(state.scene, camera, region, rows)
        return layers.show_within(state, name, weights, shows)

    def mend_drawn(
        self, points: m.DrawnLine, radius: m.Share = 0.03, soft: m.Share = 0.5
    ) -> StudioState:
        """Recolour what a brush touches from what is around it."""
        state, camera = self.session.state, self.pictures.camera()
        region = picking.soft_brush(points, camera.size, radius, soft)
        every = torch.ones(len(state.scene.base), dtype=torch.bool)
        reach = picking.reach_of(state.scene, camera, region, radius)
        weights = picking.brushed(state.scene, camera, region, every, reach)
        return layers.mend(state, torch.where(weights > LEAST_TOUCH, weights, 0.0))

    def guide_drawn(
        self, name: m.ShortText, points: m.DrawnLine, reach: m.GuideReach = 0.1
    ) -> None:
        """Let the strokes of a layer follow a line as well, of which a draft is painted."""
        state = self.session.state
        layer = layers.find_layer(state.scene, name)
        layers.refuse_locked(state, name)
        known = [*self.guides_of(name).get("guides", ())]
        if len(known) >= MOST_GUIDES:
            raise StyleSplatError(
                f"{name} has {MOST_GUIDES} lines, and no more. Remove them first."
            )
        line = line_on(state.scene, layer, self.pictures.camera(), points)
        numbers = to_world(line, state.scene.world_offset).flatten().tolist()
        guide = ",".join(str(round(each, picking.DECIMALS)) for each in numbers)
        self.repaint(layer, {"guides": [*known, guide], "guide_reach": reach, "quality": "draft"})

    def guides_of(self, name: str) -> dict[str, Any]:
        """The lines that a layer's strokes follow, or that are ordered for it, and their reach."""
        layer = self.session.state.scene.layer(name)
        settings = self.queue.ordered_settings(name) or (layer.settings if layer else {})
        return {key: settings[key] for key in ("guides", "guide_reach") if settings.get("guides")}

    def repaint(self, layer: Layer, settings: Mapping[str, Any]) -> None:
        """Paint a layer again in its own style, with other settings than now, or than ordered."""
        now = {"intensity": layer.strength, "form": layer.form}
        style = layers.painted_style(layer, **{**now, **self.guides_of(layer.name), **settings})
        how = described_change(settings)
        self.queue.paint([layer.name], style, layer_title(layer), instead=True, how=how)


def described_change(settings: Mapping[str, Any]) -> str:
    """Other settings of a painting, for the note of its step."""
    if "guides" in settings:
        count = len(settings["guides"])
        return f", along {count_noun(count, 'line')}" if count else ", without lines"
    others = [f"{key} {value}" for key, value in settings.items() if key != "quality"]
    return f", {', '.join(others) or 'finished'}"


@torch.no_grad()
def line_on(
    scene: Scene, layer: Layer, camera: Cameras, points: Sequence[m.PicturePoint]
) -> Float[Tensor, "P 3"]:
    """The places on the object of a layer that lie below a line."""
    own = scene.to_splats(layer.covered(len(scene.base)))
    shown = coverage(scene.splats, camera, own)
    depths, alphas = expected_depth(scene.splats, camera)
    rows = torch.linspace(0, len(points) - 1, min(len(points), GUIDE_PLACES)).round().long()
    size = torch.tensor(camera.size)
    pixels = (torch.tensor(points)[rows] * size).minimum(size - 0.5)
    x, y = pixels.long().unbind(dim=1)
    kept = (shown[y, x] > COVERED) & (alphas[y, x] > COVERED)
    if kept.sum() < 2:
        raise StyleSplatError(f"The line does not lie on {layer.object}. Draw it there.")
    return unproject(pixels[kept], depths[y, x][kept], camera)
