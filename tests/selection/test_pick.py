import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from balls import CAMERAS, PLAIN, SHARPNESS, SPLATS, class_probabilities
from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import object_ids, pick, render_labels, resolve_ids


def project(camera: Cameras, point: tuple[float, float, float]) -> tuple[float, float]:
    x, y, z = camera.Ks[0] @ (camera.viewmats[0] @ torch.tensor([*point, 1.0]))[:3]
    return float(x / z), float(y / z)


def own_class(splats: Splats, column: int) -> torch.Tensor:
    assert splats.identities is not None
    return splats.identities[:, column] == 1


def test_a_floater_is_removed_unless_it_touches_the_object_and_labels_vouch_for_it():
    """Labels in doubt do not: 0.75 is above the threshold, and no proof."""
    means, scales = SPLATS.means.clone(), SPLATS.scales.clone()
    row = int(own_class(SPLATS, 1).nonzero()[0])
    means[row] = torch.tensor([40.0, 40.0, 40.0])
    far = replace(SPLATS, means=means)
    scales[row] = torch.tensor([50.0, 1e-3, 1e-3]).log()
    large = replace(far, scales=scales)
    assert SPLATS.identities is not None
    identities = SPLATS.identities.clone()
    identities[row] *= 0.5 + math.log(3) / SHARPNESS
    doubtful = replace(large, identities=identities)
    assert 0.7 < class_probabilities(doubtful)[row, 1] < 0.8
    for splats, stays in ((far, False), (large, True), (doubtful, False)):
        assert bool(pick(splats, object_id=3)[row]) == stays
        assert pick(splats, object_id=3, remove_outliers=False)[row]


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
    assert (*labels.unique().tolist(),) == (0, *object_ids(SPLATS)) == (0, 3, 7, 300)
    assert (labels[0] == 0).all()


FIRST_VIEW = {"camera": CAMERAS[0]}


@pytest.mark.parametrize(
    ("ways", "fact"),
    [
        ({"object_id": 3, "threshold": 1.5}, "1.5 is no probability"),
        ({"object_id": 3, "threshold": 1.0}, r"No Gaussian is object 3 .*Lower the threshold"),
        *(
            ({"object_id": id}, rf"Object {id} does not exist.*: 3, 7, 300\.")
            for id in (4, -1, 301)
        ),
        ({"object_id": [3, 0]}, r"0 is no object.* SCENE --name NAME --background"),
        ({}, "exactly one"),
        ({"object_id": 3, "point": (1.0, 1.0)}, "exactly one"),
        ({"point": (1.0, 1.0)}, "needs the one view"),
        ({"point": (1.0, 1.0), "camera": CAMERAS}, "needs the one view"),
        ({"point": (1.0, 1.0), **FIRST_VIEW}, r"no object at 1,1 in 0000\.jpg"),
        *(
            ({"point": point, **FIRST_VIEW}, r"outside 0000\.jpg, which is 48x36")
            for point in ((48.0, 1.0), (1.0, 36.0), (-1.0, 1.0), (math.nan, 1.0))
        ),
        *(
            ({"box": box, **FIRST_VIEW}, "is empty")
            for box in ((5.0, 5.0, 5.0, 9.0), (9.0, 5.0, 5.0, 9.0), (5.0, 9.0, 9.0, 5.0))
        ),
        *(
            ({"box": box, **FIRST_VIEW}, "reaches outside")
            for box in ((-9.0, 0.0, 9.0, 9.0), (0.0, 0.0, 57.0, 9.0), (0.0, 0.0, 9.0, 45.0))
        ),
    ],
)
def test_what_picks_nothing_is_refused(ways: dict[str, Any], fact: str):
    with pytest.raises(StyleSplatError, match=fact):
        pick(SPLATS, **ways)
    with pytest.raises(StyleSplatError, match="Train from a capture with label maps"):
        pick(PLAIN, object_id=3)
