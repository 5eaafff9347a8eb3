"""World frames: similarity transforms of cameras and splats."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats, sh_basis
from stylesplat.scene.world_offset import ORIGIN, Offset, from_world, to_world

# `ns-process-data` writes COLMAP's world with these axes: x, z, -y
NERFSTUDIO_AXES = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Frame:
    """A similarity from the capture's world: `scale * rotation @ x + shift`."""

    rotation: Float[Tensor, "3 3"]
    scale: float = 1.0
    shift: Float[Tensor, "3"] | None = None

    def place(self, points: Float[Tensor, "M 3"]) -> Float[Tensor, "M 3"]:
        """Transforms points of the capture's world to this frame."""
        moved = self.scale * points @ self.rotation.to(points).T
        return moved if self.shift is None else moved + self.shift.to(points)

    def inverse(self) -> "Frame":
        shift = None if self.shift is None else -(self.shift @ self.rotation) / self.scale
        return Frame(self.rotation.T, 1 / self.scale, shift)


FRAME_TOLERANCE = 1e-3  # of a rotation times its transpose; files round to about six digits
EXACT_WITHIN = 1e-6  # of quarter turns and of scale 1, which are then taken as exact


def similarity_frame(
    linear: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"], what: str
) -> Frame | None:
    """The frame of an affine transform that a file has; None for the identity.

    A ValueError if it is no similarity; `what` names the transform in it.
    """
    with np.errstate(all="ignore"):  # an overflow is refused below
        scale = float(np.cbrt(np.linalg.det(linear)))
        rotation = linear / scale
        error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not (scale > 0 and error < FRAME_TOLERANCE and np.isfinite([*linear, shift]).all()):
        fault = f"{what} mirrors, shears or stretches its splats"
        raise ValueError(f"{fault}. Apply its transform where you made it")
    u, _, vt = np.linalg.svd(rotation)
    rotation = u @ vt
    if np.abs(rotation - rotation.round()).max() < EXACT_WITHIN:
        rotation = rotation.round() + 0.0  # no -0
    scale = 1.0 if abs(scale - 1) < EXACT_WITHIN else scale
    if scale == 1 and (rotation == np.eye(3)).all() and not shift.any():
        return None
    return Frame(torch.from_numpy(rotation), scale, torch.from_numpy(shift))


FRAME_SAME = Frame(torch.eye(3))


def move_cameras(cameras: Cameras, frame: Frame) -> Cameras:
    """The same cameras in another world frame."""
    rotation = frame.rotation.to(cameras.viewmats)
    positions = frame.place(cameras.positions)
    viewmats = cameras.viewmats.clone()
    viewmats[:, :3, :3] = cameras.viewmats[:, :3, :3] @ rotation.T
    viewmats[:, :3, 3] = -torch.einsum("cij,cj->ci", viewmats[:, :3, :3], positions)
    return replace(cameras, viewmats=viewmats)


def in_frame_of(splats: Splats, offset: Offset) -> Splats:
    """The splats relative to an offset of the world that they are in.

    Splats around the origin of a world that needs an offset are taken to be relative to it already:
    most formats cannot hold it.
    """
    middle = splats.means.median(dim=0).values
    away = from_world(to_world(middle, splats.world_offset), offset)
    if splats.world_offset == ORIGIN and middle.norm() < away.norm():
        return replace(splats, world_offset=offset)
    return splats.relative_to(offset)


def with_poses_of(capture: Capture, cameras: Cameras) -> Capture:
    """A capture with the poses of other cameras of the same names, which may differ in size."""
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
        "capture": FRAME_SAME,
        "nerfstudio-axes": axes,
        "nerfstudio": _normalized(cameras, FRAME_SAME),
        "nerfstudio-colmap": _normalized(cameras, axes),
    }


def offset_of_frame(name: str, offset: Offset) -> Offset:
    """The offset of the world of a known frame, for a capture with this one."""
    if name == "capture":
        return offset
    if name == "nerfstudio-axes":
        x, y, z = (NERFSTUDIO_AXES.double() @ torch.tensor(offset).double() + 0.0).tolist()
        return x, y, z
    return ORIGIN  # these are centred


def _normalized(cameras: Cameras, before: Frame) -> Frame:
    turned = move_cameras(cameras, before)
    up = -turned.viewmats[:, 1, :3].mean(dim=0)
    upright = Rotation.align_vectors([[0.0, 0.0, 1.0]], up[None].double().cpu())[0]
    rotation = torch.from_numpy(upright.as_matrix()).to(up)
    centre = turned.positions.mean(dim=0)
    offsets = (turned.positions - centre) @ rotation.T
    scale = 1 / max(float(offsets.abs().max()), 1e-9)
    whole = rotation @ before.rotation.to(rotation)
    return Frame(whole, scale, -scale * rotation @ centre)


DIRECTIONS = 64  # 7 functions of the third degree are fixed by 7; more keep the system well-posed
GOLDEN = math.pi * (3 - math.sqrt(5))  # golden angle: spreads directions evenly
FRAME_EXACT = 1e-9  # float64 solves a half turn to 1e-15; entries so close to 0 or 1 are rounded


def move_splats(splats: Splats, frame: Frame) -> Splats:
    """The same splats in another world frame, with their higher colour bands rotated.

    A half turn about an axis changes nothing but signs and is exact, as is no turn at all.
    """
    rotation = frame.rotation.double()
    shN = splats.shN
    if not torch.equal(rotation, torch.eye(3).double()):
        shN = torch.einsum("lk,nkc->nlc", _band_turn(rotation, splats.sh_degree).to(shN), shN)
    w, x, y, z = Rotation.from_matrix(rotation.numpy()).as_quat(scalar_first=True).tolist()
    product = torch.tensor([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return replace(
        splats,
        means=frame.place(splats.means),
        quats=splats.quats @ product.to(splats.quats).T,
        scales=splats.scales + math.log(frame.scale),
        shN=shN.contiguous(),
    )


def _band_turn(rotation: Float[Tensor, "3 3"], degree: int) -> Float[Tensor, "K K"]:
    """The matrix that rotates the SH coefficients of the higher bands, by least squares."""
    z = 1 - (torch.arange(DIRECTIONS).double() + 0.5) * (2 / DIRECTIONS)
    angle = GOLDEN * torch.arange(DIRECTIONS).double()
    across = (1 - z * z).sqrt()
    dirs = torch.stack([across * angle.cos(), across * angle.sin(), z], dim=1)
    after, before = sh_basis(degree, dirs), sh_basis(degree, dirs @ rotation)
    turn = torch.linalg.lstsq(after, before).solution
    whole = turn.round()
    return torch.where((turn - whole).abs() < FRAME_EXACT, whole, turn)[1:, 1:]
