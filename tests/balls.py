"""A still life of Gaussian balls whose objects are known exactly."""

import math
from dataclasses import replace

import torch

from stylesplat.rendering.sh import sh0_from_rgb
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import IDENTITY_SIZE, Classifier, Splats

BALLS = {  # label id: centre (x right, y forward, z up) and colour
    3: ((-0.7, 0.0, 0.3), (0.9, 0.1, 0.1)),
    7: ((0.7, 0.0, 0.3), (0.1, 0.8, 0.1)),
    300: ((0.0, 0.8, 0.3), (0.1, 0.2, 0.9)),
}
BALL_RADIUS = 0.3
SHARPNESS = 12.0  # logit of a Gaussian's own class; background wins where nothing is
CLASSIFIER = Classifier(
    weight=SHARPNESS * torch.eye(IDENTITY_SIZE)[: len(BALLS) + 1],
    bias=torch.tensor([SHARPNESS / 2] + [0.0] * len(BALLS)),
    ids=(0, *BALLS),
)


def _viewmat(position: tuple[float, float, float]) -> torch.Tensor:
    """World to camera, OpenCV axes, looking at the origin with z up."""
    origin = torch.tensor(position)
    forward = -origin / origin.norm()
    right = torch.linalg.cross(forward, torch.tensor([0.0, 0.0, 1.0]))
    right = right / right.norm()
    viewmat = torch.eye(4)
    viewmat[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    viewmat[:3, 3] = -viewmat[:3, :3] @ origin
    return viewmat


def _cameras() -> Cameras:
    """Eight cameras on a circle of radius 3 at height 1.5, 48x36 pixels."""
    angles = [2 * math.pi * i / 8 for i in range(8)]
    viewmats = [_viewmat((-3 * math.sin(a), -3 * math.cos(a), 1.5)) for a in angles]
    K = torch.tensor([[50.0, 0.0, 24.0], [0.0, 50.0, 18.0], [0.0, 0.0, 1.0]])
    return Cameras(
        viewmats=torch.stack(viewmats),
        Ks=K.expand(8, 3, 3).clone(),
        sizes=torch.tensor([48, 36]).expand(8, 2).clone(),
        names=tuple(f"{i:04d}.jpg" for i in range(8)),
    )


def enlarged(cameras: Cameras, factor: int) -> Cameras:
    """The same views with so many times more pixels each way."""
    Ks = cameras.Ks.clone()
    Ks[:, :2] *= factor
    return replace(cameras, Ks=Ks, sizes=factor * cameras.sizes)


def _splats() -> Splats:
    """A grey table (background) and three balls; class k has the k-th unit vector as identity."""
    generator = torch.Generator().manual_seed(0)
    table = torch.rand(200, 3, generator=generator) * torch.tensor([2.4, 2.4, 0.0]) - 1.2
    table[:, 2] = 0.0
    means, colors, classes = [table], [torch.full((200, 3), 0.5)], [torch.zeros(200)]
    for number, (centre, color) in enumerate(BALLS.values(), start=1):
        dirs = torch.nn.functional.normalize(torch.randn(80, 3, generator=generator), dim=-1)
        means.append(torch.tensor(centre) + BALL_RADIUS * dirs)
        colors.append(torch.tensor(color).expand(80, 3))
        classes.append(torch.full((80,), float(number)))
    labels = torch.cat(classes).long()
    count = len(labels)
    return Splats(
        means=torch.cat(means),
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), math.log(0.07)),
        opacities=torch.full((count,), 3.0),
        sh0=sh0_from_rgb(torch.cat(colors))[:, None],
        shN=torch.zeros(count, 0, 3),
        identities=torch.eye(IDENTITY_SIZE)[labels],
        classifier=CLASSIFIER,
    )


SPLATS, CAMERAS = _splats(), _cameras()
