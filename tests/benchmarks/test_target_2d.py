import torch
from target_2d import Sight, canvas, target_2d

from balls import CAMERAS
from striped_balls import FAST, SCENE, ball
from stylesplat.evaluation.measure import view_loss
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.shares import COVERED, coverage
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.objective import Objective
from stylesplat.stylization.target import style_features


def sight() -> Sight:
    share = coverage(SCENE, CAMERAS[0], ball(0)).clamp(0, 1)[..., None]
    return Sight(CAMERAS[0], share, rasterize(SCENE, CAMERAS[0])[0][0].clamp(0, 1))


def test_a_canvas_of_a_smaller_size_has_smaller_cells(network: FeatureNetwork):
    at = sight()
    full, half = (canvas(at, at.before, size, [network.cells(2)]) for size in (1.0, 0.5))
    assert torch.equal(full.render(SCENE), at.before)
    assert half.render(SCENE).shape[0] == round(at.before.shape[0] / 2)
    assert 3 < full.pixels.sum() / half.pixels.sum() < 5


def test_free_pixels_come_closer_and_leave_the_rest(network: FeatureNetwork, stripes: torch.Tensor):
    at = sight()
    (targets,) = style_features(stripes, network, (2,), length=48.0)
    index = build_index(targets, torch.float32)
    objective = Objective(network, [index], SCENE, FAST)
    found = target_2d(at, stripes.reshape(-1, 3), [(1.0, objective)], 20)
    assert torch.equal(found[at.share[..., 0] == 0], at.before[at.share[..., 0] == 0])
    losses = []
    for image in (at.before, found):
        view = canvas(at, image, 1.0, [network.cells(2)])
        losses.append(float(view_loss(image, view, [targets], network, (2,))))
    assert losses[1] < 0.8 * losses[0]
    assert (at.share > COVERED).any()
