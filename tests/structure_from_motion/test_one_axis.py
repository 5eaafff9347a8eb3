"""Poses of an object on a turntable, found one by one with errors, become turns about one axis."""

import itertools
from dataclasses import astuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stylesplat.photo_libraries import pycolmap
from stylesplat.structure_from_motion.one_axis import find_missing_sides, turn_on_one_axis

STEPS, POINTS, FOCAL, SIZE = 24, 300, 900.0, (640, 480)
NAMES = [f"{row:02}.jpg" for row in range(STEPS)]
TILT = Rotation.from_euler("xz", [25, 4], degrees=True)  # of the camera towards the axis
AWAY = np.array([0.1, -0.2, 6.0])


def turn(row: int) -> Rotation:
    return TILT * Rotation.from_euler("y", 360 * row / STEPS, degrees=True)


def model(error: float, *, axis: bool = True) -> pycolmap.Reconstruction:
    """Photos of points, each in half of them; poses are off by so many degrees, or go anywhere."""
    generator = np.random.default_rng(0)
    found = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=SIZE[0], height=SIZE[1], camera_id=1,
        params=[FOCAL * (1 + 0.02 * error), SIZE[0] / 2, SIZE[1] / 2, 0.01 * error],
    )  # fmt: skip
    found.add_camera_with_trivial_rig(camera)
    points = generator.normal(size=(POINTS, 3))
    seen = generator.random((STEPS, POINTS)) < 0.5
    for row in range(STEPS):
        placed = turn(row).apply(points) + AWAY
        places = FOCAL * placed[:, :2] / placed[:, 2:] + np.array(SIZE) / 2
        places += generator.normal(0, 0.3, places.shape)
        image = pycolmap.Image(
            name=NAMES[row], camera_id=1, image_id=row + 1,
            points2D=[pycolmap.Point2D(xy) for xy in places[seen[row]]],
        )  # fmt: skip
        off = generator.normal(0, error if axis else 90, 3)
        rotation = Rotation.from_euler("xyz", off, degrees=True) * turn(row)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation.as_matrix()), AWAY)
        found.add_image_with_trivial_frame(image, pose)
    number = np.cumsum(seen, axis=1) - 1
    for point in range(POINTS):
        photos = np.flatnonzero(seen[:, point]).tolist()
        elements = [pycolmap.TrackElement(row + 1, int(number[row, point])) for row in photos]
        moved = points[point] + generator.normal(0, 0.02 * error, 3)
        found.add_point3D(moved, pycolmap.Track(elements), np.zeros(3, np.uint8))
    found.update_point_3d_errors()
    return found


def errors(found: pycolmap.Reconstruction) -> np.ndarray:
    """Degrees between steps as they are and as they were found."""
    turns = [found.images[row + 1].cam_from_world().rotation.matrix() for row in range(STEPS)]
    steps = Rotation.from_matrix([b @ a.T for a, b in itertools.pairwise(turns)])
    truth = Rotation.concatenate([turn(row + 1) * turn(row).inv() for row in range(STEPS - 1)])
    return np.degrees((steps * truth.inv()).magnitude())


def test_poses_with_errors_become_turns_about_one_axis():
    found = model(error=1.0)
    before = errors(found)
    assert turn_on_one_axis(found, NAMES)
    assert before.max() > 2
    assert errors(found).max() < 0.1
    assert found.cameras[1].params[0] == pytest.approx(FOCAL, rel=0.01)
    assert found.compute_mean_reprojection_error() < 0.6


@pytest.mark.parametrize(
    ("rows", "names", "sides"),
    [
        (range(24), NAMES, []),
        ([*range(8), *range(16, 24)], NAMES, [(105, 240, "08.jpg", "15.jpg")]),
        (range(10), NAMES, [(135, 360, "10.jpg", "23.jpg")]),
        (range(4, 14), NAMES, [(195, 60, "14.jpg", "03.jpg")]),
        (range(0, 24, 2), NAMES, []),
        (range(12), NAMES[:12], []),
        (range(0, 12, 2), NAMES[:13], []),
        (range(8), NAMES[:13], [(105, 180, "08.jpg", "12.jpg")]),
        ([*range(8), 11, 12, *range(16, 24)], NAMES, [(105, 165, "08.jpg", "10.jpg"),
                                                       (180, 240, "13.jpg", "15.jpg")]),
        (range(4, 13), NAMES[:17], [(180, 240, "13.jpg", "16.jpg"), (0, 60, "00.jpg", "03.jpg")]),
        ([*range(5), *range(19, 24)], NAMES[::2] + NAMES[1::2][::-1], []),
    ],
    ids=["all", "a third", "one end", "both ends", "each second", "half a turn", "half of these",
         "half a turn without its end", "two sides", "both ends of a part", "there and back"],
)  # fmt: skip
def test_sides_are_missing_that_only_photos_without_a_pose_show(rows, names, sides):
    found = model(error=0.3)
    for name in {*NAMES} - {names[row] for row in rows}:
        (image,) = (each for each in found.images.values() if each.name == name)
        found.deregister_frame(image.frame_id)
    assert [astuple(each) for each in find_missing_sides(found, names)] == sides


def test_cameras_that_go_anywhere_are_left_as_they_are():
    found = model(error=1.0, axis=False)
    poses = [image.cam_from_world().matrix() for image in found.images.values()]
    assert not turn_on_one_axis(found, NAMES)
    assert not [*find_missing_sides(found, NAMES)]
    assert all(
        (image.cam_from_world().matrix() == pose).all()
        for image, pose in zip(found.images.values(), poses, strict=True)
    )
