"""Other world frames that a splat of the same photos may be in."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture

# `ns-process-data` writes COLMAP's world with these axes: x, z, -y
NERFSTUDIO_AXES = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Frame:
    """A similarity from the capture's world: `scale * rotation @ x + shift`."""

    rotation: Float[Tensor, "3 3"]
    """Applied first."""
    scale: float = 1.0
    """Applied to the rotated."""
    shift: Float[Tensor, "3"] | None = None
    """Added last; None is no shift."""

    def place(self, points: Float[Tensor, "M 3"]) -> Float[Tensor, "M 3"]:
        """Where points of the capture's world lie in this frame."""
        moved = self.scale * points @ self.rotation.to(points).T
        return moved if self.shift is None else moved + self.shift.to(points)

    def inverse(self) -> "Frame":
        """The way back."""
        shift = None if self.shift is None else -(self.shift @ self.rotation) / self.scale
        return Frame(self.rotation.T, 1 / self.scale, shift)


SAME = Frame(torch.eye(3))


def seen_from(cameras: Cameras, frame: Frame) -> Cameras:
    """The same cameras in another world frame."""
    rotation = frame.rotation.to(cameras.viewmats)
    positions = frame.place(cameras.positions)
    viewmats = cameras.viewmats.clone()
    viewmats[:, :3, :3] = cameras.viewmats[:, :3, :3] @ rotation.T
    viewmats[:, :3, 3] = -torch.einsum("cij,cj->ci", viewmats[:, :3, :3], positions)
    return replace(cameras, viewmats=viewmats)


def posed_as(capture: Capture, cameras: Cameras) -> Capture:
    """A capture whose cameras stand where others of the same names do, be they of another size.

    Raises:
        StyleSplatError: If one of its photos has no such camera.
    """
    posed = cameras[[cameras.index(name) for name in capture.cameras.names]]
    Ks = posed.Ks.clone()
    Ks[:, :2] *= (capture.cameras.sizes / posed.sizes)[:, :, None].to(Ks)
    moved = replace(posed, Ks=Ks, sizes=capture.cameras.sizes)
    return replace(capture, cameras=moved, full=posed)


def known_frames(cameras: Cameras) -> dict[str, Frame]:
    """The frames in which common programs export splats of these cameras, by name.

    nerfstudio's dataparser turns the cameras' mean up towards z, centres them and shrinks them
    into a cube of side 2; a capture that is COLMAP's own had its axes exchanged before.
    """
    axes = Frame(NERFSTUDIO_AXES)
    return {
        "capture": SAME,
        "nerfstudio-axes": axes,
        "nerfstudio": _normalized(cameras, SAME),
        "nerfstudio-colmap": _normalized(cameras, axes),
    }


def _normalized(cameras: Cameras, before: Frame) -> Frame:
    turned = seen_from(cameras, before)
    up = torch.nn.functional.normalize(-turned.viewmats[:, 1, :3].mean(dim=0), dim=0)
    rotation = _between(up, torch.tensor([0.0, 0.0, 1.0]).to(up))
    centre = turned.positions.mean(dim=0)
    offsets = (turned.positions - centre) @ rotation.T
    scale = 1 / max(float(offsets.abs().max()), 1e-9)
    whole = rotation @ before.rotation.to(rotation)
    return Frame(whole, scale, -scale * rotation @ centre)


def _between(one: Float[Tensor, "3"], other: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """The smallest rotation from one direction to another (Rodrigues)."""
    axis = torch.linalg.cross(one, other)
    sine, cosine = axis.norm(), one @ other
    if sine < 1e-6:  # the same direction, or the opposite one: any axis will do
        return torch.eye(3).to(one) if cosine > 0 else torch.diag(one.new_tensor([1, -1, -1]))
    x, y, z = (axis / sine).tolist()
    skew = one.new_tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return torch.eye(3).to(one) + sine * skew + (1 - cosine) * skew @ skew
