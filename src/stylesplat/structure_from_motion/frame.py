"""A world frame to work in, for photos whose poses come without one."""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.frames import Frame
from stylesplat.scene.poses import up_vector
from stylesplat.structure_from_motion.centre import find_centre
from stylesplat.structure_from_motion.ground import ground_normal

ROUNDS = 5  # of finding out which cameras are rolled
LEVEL = 0.2  # sine of a camera's roll (12 degrees), up to which it counts as held level
SAME_WAY = 0.2  # length of the level part of the mean view direction; photos all around have less
TINY = 1e-9


def working_frame(cameras: Cameras, points: Float[Tensor, "M 3"]) -> Frame:
    """The frame in which up is up, the content is in the middle, and distances are about 1.

    Up is -y: y points down, as in the cameras' own OpenCV axes and as viewers of splats expect.
    It is the direction that cameras which are held level agree on, or close to it the normal of
    the table or floor that things stand on. The origin is what the cameras look at, z points
    ahead of them (of the first, where they stand all around), and their median distance is 1.
    The same scene in another frame gives the same result.

    Args:
        cameras: At least one, upright.
        points: Of the scene; there may be none.

    Returns:
        The way there from the frame that cameras and points are in.
    """
    centre = find_centre(cameras, points).place
    distance = float((cameras.positions.double() - centre).norm(dim=1).median())
    scale = 1 / distance if distance > TINY else 1.0
    up = camera_up(cameras)
    normal = ground_normal(scale * (points.double() - centre), up)
    rotation = _axes(cameras, up if normal is None else normal)
    return Frame(rotation, scale, -scale * rotation @ centre)


def camera_up(cameras: Cameras) -> Float[Tensor, "3"]:
    """The direction that is up for most cameras; those that are rolled are left out."""
    up = up_vector(cameras)
    rows = list(range(len(cameras)))
    for _ in range(ROUNDS):
        rolls = (cameras.viewmats[:, 0, :3].double() @ up).abs()
        kept = (rolls <= max(LEVEL, float(rolls.median()))).nonzero()[:, 0].tolist()
        if kept == rows:
            break
        rows, up = kept, up_vector(cameras[kept])
    return up


def _axes(cameras: Cameras, up: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Rows: to the right, down, and ahead."""
    views, tops = cameras.viewmats[:, 2, :3].double(), -cameras.viewmats[:, 1, :3].double()
    # Ahead of one that looks straight down is where its top is
    for ahead, least in ((views.mean(dim=0), SAME_WAY), (views[0], SAME_WAY), (tops[0], 0.0)):
        level = ahead - (ahead @ up) * up
        if level.norm() > least:
            break
    ahead = torch.nn.functional.normalize(level, dim=0)
    return torch.stack([torch.linalg.cross(-up, ahead), -up, ahead])
