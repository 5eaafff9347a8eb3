import math
from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SHARPNESS, SPLATS, class_probabilities
from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import object_ids, render_labels
from stylesplat.selection.pick import pick, resolve_ids


def project(camera: Cameras, point: tuple[float, float, float]) -> tuple[float, float]:
    x, y, z = camera.Ks[0] @ (camera.viewmats[0] @ torch.tensor([*point, 1.0]))[:3]
    return float(x / z), float(y / z)


def own_class(splats: Splats, column: int) -> torch.Tensor:
    assert splats.identities is not None
    return splats.identities[:, column] == 1


def test_background_is_no_object():
    assert object_ids(SPLATS) == (3, 7, 300)


def test_a_floater_is_removed_unless_asked():
    means = SPLATS.means.clone()
    row = int(own_class(SPLATS, 1).nonzero()[0])
    means[row] = torch.tensor([40.0, 40.0, 40.0])
    splats = replace(SPLATS, means=means)
    assert not pick(splats, object_id=3)[row]
    assert pick(splats, object_id=3, remove_outliers=False)[row]


def test_one_far_off_that_is_large_enough_to_touch_the_object_stays_if_labels_vouch_for_it():
    """Unless its label is in doubt: 0.75 is above the threshold, and no proof."""
    means, scales = SPLATS.means.clone(), SPLATS.scales.clone()
    row = int(own_class(SPLATS, 1).nonzero()[0])
    means[row] = torch.tensor([40.0, 40.0, 40.0])
    scales[row] = torch.tensor([50.0, 1e-3, 1e-3]).log()
    large = replace(SPLATS, means=means, scales=scales)
    assert pick(large, object_id=3)[row]
    assert SPLATS.identities is not None
    identities = SPLATS.identities.clone()
    identities[row] *= 0.5 + math.log(3) / SHARPNESS
    doubtful = replace(large, identities=identities)
    assert 0.7 < class_probabilities(doubtful)[row, 1] < 0.8
    assert not pick(doubtful, object_id=3)[row]
    assert pick(doubtful, object_id=3, remove_outliers=False)[row]


@pytest.mark.parametrize(("id", "centre"), [(3, (-0.7, 0.0, 0.3)), (7, (0.7, 0.0, 0.3))])
def test_point_and_box_agree_with_the_id(id, centre):
    for row in (0, 4):
        camera = CAMERAS[row]
        x, y = project(camera, centre)
        assert resolve_ids(SPLATS, point=(x, y), camera=camera) == (id,)
        picked = pick(SPLATS, box=(x - 4, y - 4, x + 4, y + 4), camera=camera)
        assert torch.equal(picked, pick(SPLATS, object_id=id))


def test_label_map_shows_every_ball_and_nothing_in_the_sky():
    labels = render_labels(SPLATS, CAMERAS[0])
    assert set(labels.unique().tolist()) == {0, 3, 7, 300}
    assert (labels[0] == 0).all()


def test_without_identities():
    splats = replace(SPLATS, identities=None, classifier=None)
    with pytest.raises(StyleSplatError, match="Train from a capture with label maps"):
        pick(splats, object_id=3)


@pytest.mark.parametrize("id", [4, -1, 301])
def test_unknown_id_names_the_known(id: int):
    with pytest.raises(StyleSplatError, match=rf"Object {id} does not exist.*: 3, 7, 300\."):
        pick(SPLATS, object_id=id)


def test_background_cannot_be_selected():
    with pytest.raises(StyleSplatError, match=r"0 is no object.* SCENE --name NAME --background"):
        pick(SPLATS, object_id=[3, 0])


@pytest.mark.parametrize("ways", [{}, {"object_id": 3, "point": (1.0, 1.0)}])
def test_exactly_one_way(ways: dict):
    with pytest.raises(StyleSplatError, match="exactly one"):
        pick(SPLATS, **ways)


def test_point_needs_one_camera():
    for camera in (None, CAMERAS):
        with pytest.raises(StyleSplatError, match="needs the one view"):
            pick(SPLATS, point=(1.0, 1.0), camera=camera)


@pytest.mark.parametrize("point", [(48.0, 1.0), (1.0, 36.0), (-1.0, 1.0), (float("nan"), 1.0)])
def test_point_outside(point):
    with pytest.raises(StyleSplatError, match=r"outside 0000\.jpg, which is 48x36"):
        pick(SPLATS, point=point, camera=CAMERAS[0])


def test_point_on_nothing():
    with pytest.raises(StyleSplatError, match=r"no object at 1,1 in 0000\.jpg"):
        pick(SPLATS, point=(1.0, 1.0), camera=CAMERAS[0])


@pytest.mark.parametrize("box", [(5.0, 5.0, 5.0, 9.0), (9.0, 5.0, 5.0, 9.0), (5.0, 9.0, 9.0, 5.0)])
def test_box_empty(box):
    with pytest.raises(StyleSplatError, match="is empty"):
        pick(SPLATS, box=box, camera=CAMERAS[0])


@pytest.mark.parametrize(
    "box", [(-9.0, 0.0, 9.0, 9.0), (0.0, 0.0, 57.0, 9.0), (0.0, 0.0, 9.0, 45.0)]
)
def test_box_outside(box):
    with pytest.raises(StyleSplatError, match="reaches outside"):
        pick(SPLATS, box=box, camera=CAMERAS[0])


def test_nothing_passes_the_threshold():
    with pytest.raises(StyleSplatError, match=r"No Gaussian is object 3 .*Lower the threshold"):
        pick(SPLATS, object_id=3, threshold=1.0)
