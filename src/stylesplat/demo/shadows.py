"""Whose shadow lies on the table at each pixel, close to where the object stands."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.demo.still_life import TARGET, View, photograph
from stylesplat.demo.tracer import TO_LIGHT
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.poses import look_at
from stylesplat.scene.projection import pixel_centres, project, unproject

AWAY = 60.0  # how far the key light's camera stands: its rays are as good as parallel
WIDE = 3.0  # of the table, that it sees
PIXELS = 384
FLAT = 0.01  # largest height of the table, and of what casts no shadow
FOOT = 0.06  # height up to which an object is its foot
REACH = 0.25  # from an object's foot, that is taken to be dark enough


def contact_shadows(cameras: Cameras, views: Sequence[View], seed: int) -> list[Int[Tensor, "H W"]]:
    """The ids of objects whose shadow a view shows beside them; 0 elsewhere.

    What the key light's camera sees is lit, and what it sees instead of the table casts a shadow.

    Args:
        cameras: One per view.
        views: What they see of the still life.
        seed: Of its arrangement.
    """
    light = _light()
    (lit,) = photograph(light, seed)
    seen = [_points(view, cameras[row]) for row, view in enumerate(views)]
    feet = _feet(seen, views)
    shadows = []
    for points, view in zip(seen, views, strict=True):
        places, depths = project(points, light)
        inside = ((places >= 0) & (places < PIXELS)).all(dim=1)
        x, y = places.long().clamp(0, PIXELS - 1).unbind(1)
        table = (view.labels.flatten() == 0) & (points[:, 2].abs() < FLAT)
        dark = (inside & table & (depths - lit.depth[y, x] > FLAT)).nonzero()[:, 0]
        casters = torch.zeros_like(view.labels).flatten()
        casters[dark] = lit.labels[y, x][dark]
        for id, foot in feet.items():
            rows = (casters == id).nonzero()[:, 0]
            distances, _ = foot.query(points[rows, :2].numpy())
            casters[rows[torch.from_numpy(distances > REACH)]] = 0
        shadows.append(_beside(casters.view(view.labels.shape), view.labels))
    return shadows


def _points(view: View, camera: Cameras) -> Float[Tensor, "P 3"]:
    return unproject(pixel_centres(*camera.size), view.depth.flatten(), camera)


def _feet(seen: Sequence[Float[Tensor, "P 3"]], views: Sequence[View]) -> dict[int, KDTree]:
    """By id, where objects stand."""
    points = torch.cat([*seen])
    ids = torch.cat([view.labels.flatten() for view in views])
    low = points[:, 2] < FOOT
    present = ids[low & (ids != 0)].unique().tolist()
    return {id: KDTree(points[low & (ids == id), :2].numpy()) for id in present}


def _light() -> Cameras:
    target = torch.tensor(TARGET)
    position = target + AWAY * torch.tensor(TO_LIGHT)
    focal, middle = PIXELS * AWAY / WIDE, PIXELS / 2
    return Cameras(
        viewmats=look_at(position[None], target, torch.tensor([0.0, 0.0, 1.0])),
        Ks=torch.tensor([[[focal, 0, middle], [0, focal, middle], [0, 0, 1]]]),
        sizes=torch.tensor([[PIXELS, PIXELS]]),
        names=("light",),
    )


def _beside(casters: Int[Tensor, "H W"], labels: Int[Tensor, "H W"]) -> Int[Tensor, "H W"]:
    """Shadows without the parts that do not touch their object in the image."""
    kept = torch.zeros_like(casters)
    for id in casters.unique().tolist():
        if id:
            shadow, caster = casters == id, labels == id
            kept[shadow & _touching(shadow | caster, caster)] = id
    return kept


def _touching(mask: Bool[Tensor, "H W"], other: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    """The connected parts of a mask in which there is something of the other."""
    _, parts = cv2.connectedComponents(mask.numpy().astype(np.uint8))
    touched = np.unique(parts[(mask & other).numpy()])
    return torch.from_numpy(np.isin(parts, touched[touched > 0]))
