"""Brushes on layers: what is drawn on the picture changes the scene."""

import torch

from stylesplat.studio_app import edits as layers
from stylesplat.studio_app import messages as m
from stylesplat.studio_app import selecting as picking
from stylesplat.studio_app.history import StudioState
from stylesplat.studio_app.pictures import Pictures

LEAST_TOUCH = 0.02  # of a Gaussian, by which a brush touches it


class Brushes:
    def __init__(self, pictures: Pictures) -> None:
        self.session, self.pictures = pictures.session, pictures

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
