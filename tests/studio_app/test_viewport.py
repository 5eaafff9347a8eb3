from dataclasses import replace
from pathlib import Path

import numpy as np

from balls import CAMERAS, SPLATS
from stylesplat.io.scene_folder import save
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.pick_panel import BoxHandles
from stylesplat.studio_app.picking import pick_box, pick_names
from stylesplat.studio_app.studio import studio
from stylesplat.studio_app.viewport import CameraPose, interpolate_poses, photo_pose, poses_between

START = CameraPose(np.array([0.0, 0, -4]), np.zeros(3), np.array([0.0, -1, 0]), 1.0)
END = CameraPose(np.array([2.0, 0, 0]), np.zeros(3), np.array([0.0, -1, 0]), 0.6)


def test_a_move_begins_and_ends_where_it_should_and_goes_round_the_target():
    for share, pose in ((0.0, START), (1.0, END)):
        assert np.allclose(interpolate_poses(START, END, share).position, pose.position)
    middle = interpolate_poses(START, END, 0.5)
    assert np.isclose(np.linalg.norm(middle.position), 3) and np.isclose(middle.fov, 0.8)
    assert np.isclose(np.linalg.norm(middle.up), 1)
    opposite = replace(START, position=-START.position, up=-START.up)
    assert np.isfinite(interpolate_poses(START, opposite, 0.5).position).all()
    assert np.isclose(np.linalg.norm(interpolate_poses(START, opposite, 0.5).up), 1)


def test_a_move_takes_its_time_and_the_end_is_the_last_pose():
    poses = [*poses_between(START, END, 0.06)]
    assert len(poses) > 1 and poses[-1] is END
    assert [*poses_between(START, END, 0.0)] == [END]


def test_at_a_photo_the_picture_turns_about_the_content():
    pose = photo_pose(Scene(SPLATS, CAMERAS), CAMERAS[0])
    assert np.allclose(pose.position, CAMERAS.positions[0])
    ahead = pose.target - pose.position
    assert np.allclose(ahead / np.linalg.norm(ahead), CAMERAS.viewmats[0, 2, :3], atol=1e-6)
    assert np.linalg.norm(pose.target) < 1, "the balls are about the origin"


def test_the_box_begins_around_the_pick_and_its_corners_may_cross(tmp_path: Path):
    save(Scene(SPLATS, CAMERAS), tmp_path / "balls")
    opened = studio(tmp_path / "balls", port=0, block=False)
    try:
        session, viewport = opened.session, opened.page.viewport
        session.do(lambda state: pick_names(state, ["3"]))
        assert session.worker.settle()
        box = BoxHandles(viewport)
        box.show(True)
        assert session.worker.settle() and viewport.rest.behind, "a picture would hide it"
        corners = box.corners
        assert corners is not None
        picked = pick_box(session.state, *corners)
        inside = picked.scene.objects["pick 1"].picked
        assert int((inside & session.masks.of(session.state.scene, "3")).sum()) > 60
        first, second = box._handles  # as dragging does
        places = first.position.copy(), second.position.copy()
        first.position, second.position = places[1], places[0]
        again = box.corners
        assert again is not None and np.allclose(again, corners)
        box.show(False)
        assert session.worker.settle() and not viewport.rest.behind and box.corners is None
    finally:
        opened.close()
