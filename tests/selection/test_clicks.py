import pytest
import torch
from jaxtyping import Bool
from torch.nn import functional as F

from balls import CAMERAS, enlarged
from scenes import cloud, randn
from stylesplat.errors import StyleSplatError
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.selection.clicks import PickSize
from stylesplat.verbs.select import select

# A table, two balls that touch, and one apart
CENTRES = torch.tensor([[-0.29, 0.0, 0.35], [0.29, 0.0, 0.35], [0.0, 1.2, 0.35]])
TABLE = torch.cartesian_prod(torch.linspace(-2, 2, 60), torch.linspace(-2, 2, 60))
SHELL = 0.3 * F.normalize(randn(1200, 3), dim=1)
MEANS = torch.cat([F.pad(TABLE, (0, 1)), *(centre + SHELL for centre in CENTRES)])
OF = torch.cat([torch.full((len(TABLE),), -1), torch.arange(3).repeat_interleave(len(SHELL))])
VIEWS = enlarged(CAMERAS, 4)
BARE = Scene(cloud(MEANS, 0.03, opacity=3.0), VIEWS)


def at(place: tuple[float, ...] | torch.Tensor) -> tuple[str, float, float]:
    """The pixel of a place in the first view."""
    pixels, _ = project(torch.as_tensor(place)[None], VIEWS[0])
    return VIEWS.names[0], *pixels[0].tolist()


def picked(
    *balls: int, size: PickSize | None = None, but: int | None = None
) -> Bool[torch.Tensor, " N"]:
    """What clicks on balls select."""
    others = [] if but is None else [at(CENTRES[but])]
    clicks = [at(CENTRES[ball]) for ball in balls]
    return select(BARE, "it", point=clicks, not_point=others, size=size).objects["it"].picked


def agreement(found: Bool[torch.Tensor, " N"], *balls: int) -> float:
    wanted = torch.isin(OF, torch.tensor(balls))
    return float((found & wanted).sum() / (found | wanted).sum())


def test_a_click_picks_one_ball_and_a_group_all_that_touch():
    assert agreement(picked(0), 0) > 0.7
    assert agreement(picked(0, 2), 0, 2) > 0.7
    assert agreement(picked(0, size="group"), 0, 1) > 0.7
    assert agreement(picked(0, size="group", but=1), 0) > 0.7
    part = picked(0, size="part")
    assert part.any() and not (part & ~picked(0)).any()


def test_clicks_on_the_table_and_on_nothing_are_refused():
    with pytest.raises(StyleSplatError, match="Background shows"):
        select(BARE, "table", point=at((0.9, -0.9, 0.0)))
    with pytest.raises(StyleSplatError, match="Nothing solid"):
        select(BARE, "air", point=(VIEWS.names[0], 0, 0))
    with pytest.raises(StyleSplatError, match="hit the same place"):
        picked(0, but=0)
    with pytest.raises(StyleSplatError, match="go with --point"):
        select(BARE, "it", all=True, not_point=at(CENTRES[0]))
