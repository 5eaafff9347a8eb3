from dataclasses import replace

import numpy as np

from balls import CAMERAS, SPLATS
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.viewport import CameraPose, interpolate_poses, photo_pose, poses_between

START = CameraPose(np.array([0.0, 0, -4]), np.zeros(3), np.array([0.0, -1, 0]), 1.0)
END = CameraPose(np.array([2.0, 0, 0]), np.zeros(3), np.array([0.0, -1, 0]), 0.6)


def test_a_flight_begins_and_ends_where_it_should_and_goes_round_the_target():
    for share, stand in ((0.0, START), (1.0, END)):
        assert np.allclose(interpolate_poses(START, END, share).position, stand.position)
    middle = interpolate_poses(START, END, 0.5)
    assert np.isclose(np.linalg.norm(middle.position), 3) and np.isclose(middle.fov, 0.8)
    assert np.isclose(np.linalg.norm(middle.up), 1)
    opposite = replace(START, position=-START.position, up=-START.up)
    assert np.isfinite(interpolate_poses(START, opposite, 0.5).position).all()
    assert np.isclose(np.linalg.norm(interpolate_poses(START, opposite, 0.5).up), 1)


def test_a_flight_takes_its_time_and_the_end_is_the_last_place():
    places = [*poses_between(START, END, 0.06)]
    assert len(places) > 1 and places[-1] is END
    assert [*poses_between(START, END, 0.0)] == [END]


def test_at_a_photo_the_picture_turns_about_the_content():
    stand = photo_pose(Scene(SPLATS, CAMERAS), CAMERAS[0])
    assert np.allclose(stand.position, CAMERAS.positions[0])
    ahead = stand.target - stand.position
    assert np.allclose(ahead / np.linalg.norm(ahead), CAMERAS.viewmats[0, 2, :3], atol=1e-6)
    assert np.linalg.norm(stand.target) < 1, "the balls are about the origin"
