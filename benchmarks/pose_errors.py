"""How far cameras are from where they should be, whatever world frame they are in."""

from dataclasses import dataclass, replace
from math import sqrt

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.frames import Frame, seen_from

ROUNDS = 5  # of leaving out what does not fit and fitting again
OUTLIER = 3.0  # times the median distance, from which a camera does not count for the fit


@dataclass(frozen=True)
class PoseErrors:
    """By camera, after the frames were brought together by the cameras' centres."""

    frame: Frame
    """From the found cameras' world to the given ones'."""
    degrees: Float[Tensor, " C"]
    """Angles between the orientations."""
    shares: Float[Tensor, " C"]
    """Distances of the centres over the given ones' spread (root mean square from their mean)."""


def pose_errors(found: Cameras, given: Cameras) -> PoseErrors:
    """Compare cameras with given ones, row by row; a few may be wrong on either side."""
    found = replace(found, viewmats=found.viewmats.double())
    given = replace(given, viewmats=given.viewmats.double())
    frame = robust_similarity(found.positions, given.positions)
    moved = seen_from(found, frame)
    turns = moved.viewmats[:, :3, :3] @ given.viewmats[:, :3, :3].mT
    chords = (turns - torch.eye(3).to(turns)).flatten(1).norm(dim=1)  # 2 sqrt(2) sin(angle / 2)
    angles = 2 * torch.asin((chords / (2 * sqrt(2))).clamp(max=1))
    offsets = given.positions - given.positions.mean(dim=0)
    spread = offsets.square().sum(dim=1).mean().sqrt()
    distances = (moved.positions - given.positions).norm(dim=1)
    return PoseErrors(frame, torch.rad2deg(angles), distances / spread)


def robust_similarity(points: Float[Tensor, "C 3"], targets: Float[Tensor, "C 3"]) -> Frame:
    """What brings points closest to their targets, without those that are far off even so."""
    kept = torch.ones(len(points), dtype=torch.bool)
    frame = similarity(points, targets)
    for _ in range(ROUNDS):
        frame = similarity(points[kept], targets[kept])
        distances = (_moved(points, frame) - targets).norm(dim=1)
        kept = distances <= OUTLIER * distances.median()
    return frame


def similarity(points: Float[Tensor, "C 3"], targets: Float[Tensor, "C 3"]) -> Frame:
    """The least-squares similarity from points to targets (Umeyama 1991)."""
    mean, target_mean = points.mean(dim=0), targets.mean(dim=0)
    centred, target_centred = points - mean, targets - target_mean
    u, stretches, vt = torch.linalg.svd(target_centred.T @ centred)
    signs = torch.ones(3).to(points)
    signs[2] = torch.linalg.det(u @ vt).sign()  # a rotation, never a reflection
    rotation = u @ torch.diag(signs) @ vt
    scale = float((stretches * signs).sum() / centred.square().sum())
    return Frame(rotation, scale, target_mean - scale * rotation @ mean)


def _moved(points: Tensor, frame: Frame) -> Tensor:
    assert frame.shift is not None
    return frame.scale * points @ frame.rotation.T + frame.shift
