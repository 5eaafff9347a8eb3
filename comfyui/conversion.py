"""ComfyUI's values as StyleSplat's, and back: splats, selections, cameras, pictures."""

from dataclasses import replace
from typing import Any

import torch
from comfy_api.latest import Types
from torch import Tensor
from torch.nn.functional import pad

import stylesplat as ss

VIEW = "view_000"  # of a scene without photos: a camera of ComfyUI takes its place
FOV = 35.0  # degrees, of a camera that does not say
FLIPPED = (1.0, -1.0, -1.0)  # from y up, as cameras have it, to y down, as splats have it


def item_of(splat: Types.SPLAT, *tensors: Tensor) -> list[Tensor]:
    """The only item of a batch of splats, without padding.

    Raises:
        StyleSplatError: If the batch has several items.
    """
    batch = splat.positions.shape[0]
    if batch != 1:
        raise ss.StyleSplatError(f"The SPLAT is a batch of {batch}. Take one of them.")
    count = splat.positions.shape[1] if splat.counts is None else int(splat.counts[0])
    return [each[0, :count].cpu() for each in tensors]


def splats_of(splat: Types.SPLAT) -> ss.Splats:
    """The Gaussians of a SPLAT: positions, linear scales, rotations wxyz, opacities, harmonics."""
    fields = splat.positions, splat.rotations, splat.scales, splat.opacities, splat.sh
    return ss.from_gaussians(*item_of(splat, *fields))


def splat_of(splats: ss.Splats) -> Types.SPLAT:
    """A SPLAT of Gaussians, on the CPU."""
    means, quats, scales, opacities, sh = splats.to("cpu").detach().activated()
    fields = means, scales, quats, opacities[:, None], sh
    return Types.SPLAT(*(each.float()[None].contiguous() for each in fields))


def painted_splat(splat: Types.SPLAT, before: ss.Splats, after: ss.Splats) -> Types.SPLAT:
    """The SPLAT of `after`, whose first rows are those of `before`.

    What is the same in both has the values of the SPLAT given, to the bit.
    """
    made, rows = splat_of(after), len(before)
    fields = "positions", "scales", "rotations", "opacities", "sh"
    raw = ("means",), ("scales",), ("quats",), ("opacities",), ("sh0", "shN")
    old, new = before.tensors(), after[:rows].tensors()
    given = item_of(splat, *(getattr(splat, name) for name in fields))
    for name, parts, value in zip(fields, raw, given, strict=True):
        same = [(old[part] == new[part]).reshape(rows, -1).all(dim=1) for part in parts]
        kept = torch.stack(same).all(dim=0)
        getattr(made, name)[0, :rows][kept] = value[kept].float()
    return made


def selection_for(selection: Tensor | None, count: int) -> Tensor:
    """The rows of a selection in a splat that has got more at its end since; all without one.

    Raises:
        StyleSplatError: If the selection is of a larger splat.
    """
    if selection is None:
        return torch.ones(count, dtype=torch.bool)
    if len(selection) > count:
        raise ss.StyleSplatError(
            f"The selection is of {len(selection):,} Gaussians and the splat has {count:,}. Select "
            "in this splat."
        )
    return pad(selection, (0, count - len(selection)))


def camera_of(camera: dict[str, Any], size: tuple[int, int], name: str) -> ss.Cameras:
    """A camera as ComfyUI's 3D nodes give it: right-handed, y up, looking down its -z.

    Raises:
        StyleSplatError: If it is orthographic.
    """
    if str(camera.get("cameraType", "")).lower().startswith("ortho"):
        raise ss.StyleSplatError("The camera is orthographic. Use a perspective one.")
    flip = torch.tensor(FLIPPED)
    eye, target = (_vector(camera.get(key) or {}) for key in ("position", "target"))
    turn = camera.get("quaternion")
    if turn:
        right, up, back = _matrix(turn).T
    else:
        back = torch.nn.functional.normalize(eye - target, dim=0)
        right = torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]), back)
        if right.norm() < 1e-6:  # straight from above or below
            right = torch.tensor([1.0, 0.0, 0.0])
        right = torch.nn.functional.normalize(right, dim=0)
        up = torch.linalg.cross(back, right)
    rotation = torch.stack([right, -up, -back]) * flip  # rows: right, down, ahead
    viewmat = torch.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ (eye * flip)
    half = torch.deg2rad(torch.tensor(float(camera.get("fov") or FOV))) / 2
    focal = min(size) / 2 / float(half.tan()) * float(camera.get("zoom") or 1.0)
    K = torch.tensor([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
    return ss.Cameras(viewmat[None], K[None], torch.tensor([size]), (name,))


def _vector(values: dict[str, Any]) -> Tensor:
    return torch.tensor([float(values.get(axis, 0.0)) for axis in "xyz"])


def _matrix(values: dict[str, Any]) -> Tensor:
    quat = torch.tensor([float(values.get(axis, 0.0)) for axis in "wxyz"])
    w, x, y, z = quat / quat.norm()
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.tensor(rows)


def with_views(
    scene: ss.Scene, size: tuple[int, int], view: int, camera: dict[str, Any] | None
) -> tuple[ss.Scene, str]:
    """A scene whose views have a size in pixels, and the name of the view that is meant.

    Raises:
        StyleSplatError: If there is no view of this number.
    """
    cameras = scene.cameras.resize(*size)
    if camera is not None:
        view = 0
        cameras = camera_of(camera, size, cameras.names[0]) + cameras[1:]
    if not 0 <= view < len(cameras):
        raise ss.StyleSplatError(f"There is no view {view}. Choose one of 0 to {len(cameras) - 1}.")
    return replace(scene, cameras=cameras), cameras.names[view]


def pictures_of(image: Tensor) -> list[Tensor]:
    """The pictures of an IMAGE [B, H, W, C], without alpha."""
    return [*image[..., :3].float().cpu().clamp(0, 1)]
