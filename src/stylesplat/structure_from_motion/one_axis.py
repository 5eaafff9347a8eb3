"""Photos of an object on a turntable: what moves is one angle a photo.

The camera stands still and the object turns about one axis: the poses of all photos are one place
of the axis, one lens and an angle each. Poses that were found one by one say where the axis is;
bundle adjustment of those few numbers and the points makes them exact.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Integer
from scipy.optimize import least_squares
from scipy.sparse import coo_array, csr_array

from stylesplat.io.captures.colmap import posed_images
from stylesplat.photo_libraries import cv2, pycolmap
from stylesplat.progress import track
from stylesplat.structure_from_motion.world_frame import WORLD_STRIDE

ONE_AXIS = 5.0  # degrees by which poses found one by one may be off, in the median
WORSE = 1.3  # times the error of poses that are free, from which they do not turn on one axis
STEP_SPREAD = 0.05  # radians by which steps of a turntable differ
RADIAL_SPREAD = 0.05  # of the distortion of lenses; what fills half a picture hardly tells it
ADJUSTMENTS = 50
# Share of a step: if the median deviation is larger, photos are not in the order of the turn
UNEVEN_TURN = 0.5
NEAR_PARALLEL = 1e-6  # rays of which a point is left near the axis
COMMON = 8  # numbers of all photos: the focal length, the distortion, the axis, where it stands


@dataclass(frozen=True)
class _Observations:
    photos: Integer[np.ndarray, " O"]
    points: Integer[np.ndarray, " O"]
    """Rows."""
    places: Float[np.ndarray, "O 2"]
    """In pixels from the principal point."""


def turn_on_one_axis(model: pycolmap.Reconstruction, names: Sequence[str]) -> bool:
    """Make the poses of a model turns about one axis, exactly; False where they are none.

    Steps as they were found are tried, and even ones. Changes the poses and points, and the focal
    length and distortion of the one SIMPLE_RADIAL camera; `names` are those of all photos in order.
    """
    images = posed_images(model)
    cameras = {image.camera_id for image in images}
    if (
        len(cameras) > 1
        or model.cameras[min(cameras)].model != pycolmap.CameraModelId.SIMPLE_RADIAL
    ):
        return False
    camera = model.cameras[min(cameras)]
    poses = np.stack([image.cam_from_world().matrix() for image in images])
    axis, place = _axis(poses)
    world = _turn_to_y(axis)  # from the model's world to one whose y is the axis
    rotations = poses[:, :, :3] @ world.T
    angles, apart = _angles(rotations)
    if np.median(apart) > ONE_AXIS:
        return False
    shift = (poses[:, :, :3] @ place + poses[:, :, 3]).mean(axis=0)
    keys = sorted(model.points3D.keys())
    points = np.stack([model.points3D[key].xyz for key in keys])
    seen = _observations(model, images, keys, camera)
    focal, distortion = camera.params[0], camera.params[3]
    common = np.concatenate([[focal, distortion], _vector(rotations[0]), shift])
    moved = (points - place) @ world.T
    starts = [np.concatenate([common, angles, moved.ravel()])]
    rows = np.array([names.index(image.name) for image in images])
    step = np.median(np.diff(np.unwrap(angles)) / np.diff(rows))
    steps = step * np.diff(rows)
    even = step * (rows - rows[0])  # poses may be right in parts alone
    starts.append(np.concatenate([common, even, _points(common, even, seen, len(keys)).ravel()]))
    adjusted = [_adjust(start, seen, steps) for start in track(starts, "finding the axis")]
    errors = [
        np.linalg.norm(_project(each, seen, len(images))[0] - seen.places, axis=1).mean()
        for each in adjusted
    ]
    if min(errors) > WORSE * model.compute_mean_reprojection_error():
        return False
    found = adjusted[int(np.argmin(errors))]
    camera.params = [found[0], *camera.params[1:3], found[1]]
    still = cv2.Rodrigues(found[2:5])[0]
    for image, angle in zip(images, found[COMMON : COMMON + len(images)], strict=True):
        rotation = pycolmap.Rotation3d(still @ _about_y(angle))
        assert image.frame is not None, "it has a pose"
        image.frame.set_cam_from_world(image.camera_id, pycolmap.Rigid3d(rotation, found[5:8]))
    for key, point in zip(keys, found[COMMON + len(images) :].reshape(-1, 3), strict=True):
        model.points3D[key].xyz = point
    model.update_point_3d_errors()
    return True


@dataclass(frozen=True)
class MissingSide:
    """A range of angles that only photos without a pose show."""

    begin: int
    """In degrees from the first photo, in the direction of the turn."""
    end: int
    first: str
    """The first photo that shows it."""
    last: str


def find_missing_sides(
    model: pycolmap.Reconstruction, names: Sequence[str]
) -> Iterator[MissingSide]:
    """The sides that only photos without a pose show, wider than `WORLD_STRIDE`.

    Each of these photos is taken to be turned as far from its neighbours in `names`, which are
    those of all photos in order, as photos with a pose are. A side that was not photographed is not
    missing. Yields nothing if the poses do not share an axis or the turn changes direction.
    """
    images = sorted(posed_images(model), key=lambda image: names.index(image.name))
    rows = np.array([names.index(image.name) for image in images])
    poses = np.stack([image.cam_from_world().matrix() for image in images])
    angles, apart = _angles(poses[:, :, :3] @ _turn_to_y(_axis(poses)[0]).T)
    count, turns = np.diff(rows), _within_half_turn(np.diff(angles))
    step = np.median(turns / count)
    uneven = np.median(abs(turns / count - step)) > UNEVEN_TURN * abs(step)
    if uneven or np.median(apart) > ONE_AXIS:
        return
    known = np.cumsum([0, *(step * count + _within_half_turn(turns - step * count))])
    known = np.sign(step) * (known + step * rows[0])
    step, every = abs(step), np.arange(len(names))
    turned = np.interp(every, rows, known)
    turned += step * ((every - rows[-1]).clip(0) - (rows[0] - every).clip(0))
    unposed = [row for row in range(len(names)) if row not in rows]
    sides = np.sort(turned[rows] % (2 * np.pi))
    for start, width in zip(sides, np.diff([*sides, sides[0] + 2 * np.pi]), strict=True):
        beyond = (turned - start) % (2 * np.pi)
        there = sorted((row for row in unposed if beyond[row] < width), key=beyond.take)
        breaks = np.flatnonzero(np.diff(beyond[there]) > WORLD_STRIDE) + 1  # not photographed
        for run in np.split(there, breaks) if there else ():
            first, last = int(run[0]), int(run[-1])
            low = 0.0 if beyond[first] < WORLD_STRIDE else beyond[first]
            high = width if width - beyond[last] < WORLD_STRIDE else beyond[last]
            if high - low > WORLD_STRIDE:
                begin, end = (round(np.degrees(start + each)) for each in (low, high))
                yield MissingSide(begin % 360, (end - 1) % 360 + 1, names[first], names[last])


def _within_half_turn(angles: Float[np.ndarray, " A"]) -> Float[np.ndarray, " A"]:
    return (angles + np.pi) % (2 * np.pi) - np.pi


def _axis(
    poses: Float[np.ndarray, "P 3 4"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """The direction that all cameras see alike, and a point that they do; up in the photos."""
    rotations, shifts = poses[:, :, :3], poses[:, :, 3]
    mean = rotations.mean(axis=0)
    axis = np.linalg.svd(mean)[2][0]
    axis *= np.sign((mean @ axis)[1]) or 1.0  # y points down in photos
    place = np.linalg.lstsq(
        (rotations - mean).reshape(-1, 3), -(shifts - shifts.mean(axis=0)).ravel(), rcond=1e-3
    )[0]
    return axis, place


def _turn_to_y(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    return np.stack([side, axis, np.cross(side, axis)])


def _about_y(angle: float) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _angles(
    rotations: Float[np.ndarray, "P 3 3"],
) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    """Turns about y that lead from the first rotation to each, and the degrees that are left."""
    relative = rotations[0].T @ rotations
    angles = np.arctan2(
        relative[:, 0, 2] - relative[:, 2, 0], relative[:, 0, 0] + relative[:, 2, 2]
    )
    left = np.stack(
        [_about_y(angle).T @ each for angle, each in zip(angles, relative, strict=True)]
    )
    cosines = (np.trace(left, axis1=1, axis2=2) - 1) / 2
    return angles, np.degrees(np.arccos(cosines.clip(-1, 1)))


def _observations(
    model: pycolmap.Reconstruction,
    images: list[pycolmap.Image],
    keys: list[int],
    camera: pycolmap.Camera,
) -> _Observations:
    row_of_photo = {image.image_id: row for row, image in enumerate(images)}
    found = [
        (
            row_of_photo[each.image_id],
            row,
            *model.images[each.image_id].points2D[each.point2D_idx].xy,
        )
        for row, key in enumerate(keys)
        for each in model.points3D[key].track.elements
    ]
    table = np.array(found)
    rows = table[:, :2].astype(int)
    return _Observations(rows[:, 0], rows[:, 1], table[:, 2:] - camera.params[1:3])


def _vector(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    return cv2.Rodrigues(rotation)[0][:, 0]


def _points(
    common: Float[np.ndarray, " C"],
    angles: Float[np.ndarray, " P"],
    seen: _Observations,
    count: int,
) -> Float[np.ndarray, "M 3"]:
    """Points where the rays of their photos come closest to each other."""
    focal, still, shift = common[0], cv2.Rodrigues(common[2:5])[0], common[5:]
    turns = np.stack([still @ _about_y(angle) for angle in angles])[seen.photos]
    rays = np.hstack([seen.places / focal, np.ones((len(seen.places), 1))])
    rays = np.einsum("nji,nj->ni", turns, rays / np.linalg.norm(rays, axis=1)[:, None])
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    centres = -np.einsum("nji,j->ni", turns, shift)
    sums, targets = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(sums, seen.points, across)
    np.add.at(targets, seen.points, np.einsum("nij,nj->ni", across, centres))
    return np.linalg.solve(sums + NEAR_PARALLEL * np.eye(3), targets[..., None])[..., 0]


def _adjust(
    start: Float[np.ndarray, " V"], seen: _Observations, steps: Float[np.ndarray, " S"]
) -> Float[np.ndarray, " V"]:
    """Bundle adjustment of `COMMON` numbers, an angle for each photo and the points.

    `steps` are angles from photo to photo, which hold where no point is seen on both sides.
    """
    photos, count = len(steps) + 1, len(seen.photos)
    first, last = COMMON + photos, 2 * count
    columns = np.hstack(
        [
            np.broadcast_to(np.arange(COMMON), (count, COMMON)),
            COMMON + seen.photos[:, None],
            first + 3 * seen.points[:, None] + np.arange(3),
        ]
    )
    rows = np.broadcast_to(np.arange(last).reshape(-1, 2, 1), (count, 2, columns.shape[1]))
    turns = COMMON + np.arange(photos)
    behind = last + 1 + np.arange(photos - 1)
    where = (
        np.concatenate([rows.ravel(), [last], behind, behind]),
        np.concatenate(
            [np.repeat(columns[:, None], 2, axis=1).ravel(), [1], turns[1:], turns[:-1]]
        ),
    )
    known = np.concatenate([[1 / RADIAL_SPREAD], np.repeat([1, -1], photos - 1) / STEP_SPREAD])

    def residuals(values: Float[np.ndarray, " V"]) -> Float[np.ndarray, " R"]:
        places = _project(values, seen, photos)[0]
        uneven = _within_half_turn(np.diff(values[COMMON:first]) - steps)
        return np.concatenate(
            [(places - seen.places).ravel(), values[1:2] / RADIAL_SPREAD, uneven / STEP_SPREAD]
        )

    def jacobian(values: Float[np.ndarray, " V"]) -> csr_array:
        entries = np.append(_project(values, seen, photos)[1].ravel(), known)
        return coo_array((entries, where), shape=(last + photos, len(values))).tocsr()

    return least_squares(
        residuals,
        start,
        jac=jacobian,  # pyright: ignore[reportArgumentType]
        loss="soft_l1",
        x_scale="jac",
        max_nfev=ADJUSTMENTS,
    ).x


def _project(
    values: Float[np.ndarray, " V"], seen: _Observations, photos: int
) -> tuple[Float[np.ndarray, "O 2"], Float[np.ndarray, "O 2 12"]]:
    """Places of points in photos, and their derivatives by what each of them depends on."""
    (focal, distortion), vector, shift = values[:2], values[2:5], values[5:COMMON]
    angles, points = np.split(values[COMMON:], [photos])
    c, s = np.cos(angles[seen.photos]), np.sin(angles[seen.photos])
    x, y, z = points.reshape(-1, 3)[seen.points].T
    turned = np.stack([c * x + s * z, y, c * z - s * x], axis=1)
    still, slopes_of_still = cv2.Rodrigues(vector)
    placed = turned @ still.T + shift
    flat = placed[:, :2] / placed[:, 2:]
    square = (flat**2).sum(axis=1)[:, None]
    bent = 1 + distortion * square
    # of the place by the point before the camera
    by_flat = focal * (
        bent[:, :, None] * np.eye(2) + 2 * distortion * flat[:, :, None] * flat[:, None]
    )
    depth = placed[:, 2, None, None]
    by_placed = np.concatenate([by_flat, -by_flat @ flat[:, :, None]], axis=2) / depth
    by_vector = turned @ slopes_of_still.reshape(3, 3, 3).transpose(0, 2, 1)  # one of 3 each
    zero = np.zeros_like(c)
    by_angle = np.stack([c * z - s * x, zero, -s * z - c * x], axis=1) @ still.T
    turn = np.stack([c, zero, s, zero, zero + 1, zero, -s, zero, c], axis=1).reshape(-1, 3, 3)
    slopes = [
        (bent * flat)[:, :, None],
        (focal * square * flat)[:, :, None],
        by_placed @ by_vector.transpose(1, 2, 0),
        by_placed,
        by_placed @ by_angle[:, :, None],
        by_placed @ still @ turn,
    ]
    return focal * bent * flat, np.concatenate(slopes, axis=2)
