"""Strokes that follow lines: the field around them, features at angles."""

import math

import pytest
import torch
from torch.nn import functional as F

from balls import CAMERAS, PICKS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.scene.projection import project
from stylesplat.stylization.config import StyleConfig, parse_guide
from stylesplat.stylization.features import load_weights
from stylesplat.stylization.guides import Guides, picture_flow, turned_style
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.optimize import target_features
from stylesplat.stylization.style import Style

LINE = "-0.7,-0.3,0.1,-0.7,-0.3,0.5"  # upwards, before ball 3
CONFIG = StyleConfig(guides=(LINE,), guide_reach=0.2)


def stripes(degrees: float, side: int = 128) -> torch.Tensor:
    """Light and dark stripes that run at an angle, clockwise from the x axis."""
    y, x = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    angle = math.radians(degrees)
    across = y * math.cos(angle) - x * math.sin(angle)
    return (0.5 + 0.5 * torch.sin(across))[..., None].expand(side, side, 3).clone()


def flow_of(degrees: float) -> torch.Tensor:
    return torch.tensor([math.cos(math.radians(2 * degrees)), math.sin(math.radians(2 * degrees))])


@pytest.mark.parametrize("degrees", [0, 30, 90, 140])
def test_the_flow_of_a_picture_is_how_its_strokes_run(degrees: float):
    flow = picture_flow(stripes(degrees), 3.0)[20:-20, 20:-20].mean(dim=(0, 1))
    assert torch.allclose(flow, flow_of(degrees), atol=0.05)


def test_directions_count_near_the_line_alone_and_are_seen_by_each_camera():
    guides = Guides.of(CONFIG, SPLATS, PICKS["red"])
    assert guides is not None and Guides.of(StyleConfig(), SPLATS, PICKS["red"]) is None
    places = torch.tensor([[-0.7, -0.3, 0.3], [-0.7, -0.3 - guides.reach, 0.3], [0.7, 0.0, 0.3]])
    tensors = guides.tensors(places)
    upwards = torch.zeros(3, 3)
    upwards[2, 2] = 1
    assert torch.allclose(tensors[0], upwards, atol=1e-3)
    assert torch.allclose(tensors[1], upwards * math.exp(-0.5), atol=0.02)
    assert tensors[2].abs().max() < 1e-3, "the other ball"
    ends = torch.tensor(parse_guide(LINE)).view(2, 3)
    flow = guides.flow(SPLATS, CAMERAS[0], guides.tensors(SPLATS.means))
    strongest = flow.reshape(-1, 2)[flow.norm(dim=2).argmax()]
    x, y = project(ends, CAMERAS[0])[0].diff(dim=0)[0].tolist()
    assert strongest.norm() > 0.5, "the first camera sees it"
    wanted = flow_of(math.degrees(math.atan2(y, x)))
    assert torch.allclose(F.normalize(strongest, dim=0), wanted, atol=0.1)


@pytest.mark.parametrize("degrees", [0, 60, 90])
def test_features_are_matched_with_strokes_that_run_as_they_are_to(degrees: float):
    config, network = StyleConfig(scale=2.0), load_weights("compact", depth=3)
    features = target_features(network, config, [stripes(0)], 64.0)
    index = build_index(features, torch.float32, balanced=True)
    turned = turned_style(network, config, [stripes(0)], 64.0, index)
    feats, favour = features[:50], index.no_favour().favour
    flow = flow_of(degrees).expand(50, 2)
    found = turned.nearest(feats, flow, favour)
    rows = (found @ turned.directions.T).argmax(dim=1)
    agreement = (turned.flows[rows] * flow).sum(dim=1)
    assert agreement.median() > 0.8, "though the features are those of level stripes"


@pytest.mark.parametrize("line", ["", "1,2,3", "1,2,3,4,5", "a,b,c,d,e,f", "1,2,3,4,5,nan"])
def test_what_is_no_line_is_refused(line: str):
    with pytest.raises(StyleSplatError, match="two places or more"):
        Style("wave.jpg", guides=(line,))
    with pytest.raises(StyleSplatError, match="follow no lines"):
        Style("wave.jpg", preset="paper", guides=(LINE,))
