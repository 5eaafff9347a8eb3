from pathlib import Path

import numpy as np

from balls import CAMERAS, SPLATS
from stylesplat.io.scene_folder import save
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.pick_panel import BoxHandles
from stylesplat.studio_app.picking import pick_box, pick_names
from stylesplat.studio_app.studio import studio


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
