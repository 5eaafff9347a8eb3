import gc
import re
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import get_args
from weakref import ref

import pytest
import torch
from jaxtyping import Bool
from torch.nn import functional as F

from balls import CAMERAS, enlarged
from scenes import cloud, randn
from stylesplat.errors import StyleSplatError
from stylesplat.masks.box_propagation import pick_in_boxes
from stylesplat.options import PickSize
from stylesplat.progress import Observer, Task, observed
from stylesplat.rendering.weights import coverage
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.selection.surface_cut import pick_masked
from stylesplat.verbs.select import select

# A table, two balls that overlap, and one apart
CENTRES = torch.tensor([[-0.29, 0.0, 0.35], [0.29, 0.0, 0.35], [0.0, 1.2, 0.35]])
TABLE = torch.cartesian_prod(torch.linspace(-2, 2, 60), torch.linspace(-2, 2, 60))
SHELL = 0.3 * F.normalize(randn(1200, 3), dim=1)
MEANS = torch.cat([F.pad(TABLE, (0, 1)), *(centre + SHELL for centre in CENTRES)])
OF = torch.cat([torch.full((len(TABLE),), -1), torch.arange(3).repeat_interleave(len(SHELL))])
VIEWS = enlarged(CAMERAS, 4)
BARE = Scene(cloud(MEANS, 0.03, opacity=3.0), VIEWS)


def under_a_dome() -> Splats:
    """All of it, and what fills the views behind it."""
    dome = 5 * F.normalize(randn(6000, 3), dim=1)
    splats = cloud(torch.cat([MEANS, dome]), 0.03, opacity=3.0)
    splats.scales[len(MEANS) :] += 2.3  # ten times as large
    return splats


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
    return select(BARE, "it", point=clicks, not_point=others, size=size).objects["it"].mask


def agreement(found: Bool[torch.Tensor, " N"], *balls: int) -> float:
    wanted = torch.isin(OF, torch.tensor(balls))
    return float((found & wanted).sum() / (found | wanted).sum())


def test_a_click_picks_one_body_and_a_group_all_that_touch():
    assert agreement(picked(2), 2) > 0.7
    assert agreement(picked(0), 0, 1) > 0.7, "their neck is as wide as a toy's"
    assert agreement(picked(0, but=1), 0) > 0.7
    assert agreement(picked(0, 2), 0, 1, 2) > 0.7
    assert agreement(picked(0, size="group"), 0, 1) > 0.7
    assert agreement(picked(0, size="group", but=1), 0) > 0.7


def test_a_click_tells_what_the_other_sizes_take(said: list[str]):
    counts = {size: f"{picked(0, size=size).sum():,}" for size in get_args(PickSize)}
    said.clear()
    picked(0)
    others = f"--size part {counts['part']}, --size group {counts['group']}"
    assert said == [f"object: {counts['object']} Gaussians; {others}."]
    said.clear()
    select(BARE, "table", point=at((0.9, -0.9, 0.0)), size="part")
    assert len(said) == 1 and re.fullmatch(r"part: [\d,]+ Gaussians\.", said[0])


def test_a_part_is_bounded_by_its_color_and_may_lie_flat_on_a_plane():
    sheet = (OF < 0) & (MEANS[:, :2] - torch.tensor([0.9, -0.9])).norm(dim=1).lt(0.5)
    cap = (OF == 2) & (MEANS[:, 2] > 0.35)
    red = torch.where((sheet | cap)[:, None, None], torch.tensor([1.5, -1.5, -1.5]), 0.0)
    scene = Scene(replace(BARE.splats, sh0=red), VIEWS)
    for wanted, place in ((sheet, (0.9, -0.9, 0.0)), (cap, (0.0, 1.2, 0.65))):
        found = select(scene, "it", point=at(place), size="part").objects["it"].mask
        assert float((found & wanted).sum() / (found | wanted).sum()) > 0.7


def test_clicks_on_the_table_and_on_nothing_are_refused():
    with pytest.raises(StyleSplatError, match=r"Background shows.* Here: --size part [\d,]+ Gaus"):
        select(BARE, "table", point=at((0.9, -0.9, 0.0)))
    with pytest.raises(StyleSplatError, match="Nothing solid"):
        select(BARE, "air", point=(VIEWS.names[0], 0, 0))
    with pytest.raises(StyleSplatError, match="hit the same place"):
        picked(0, but=0)
    with pytest.raises(StyleSplatError, match="go with --point"):
        select(BARE, "it", all=True, not_point=at(CENTRES[0]))


def test_a_click_on_a_curved_backdrop_is_refused():
    scene = Scene(under_a_dome(), VIEWS)
    backdrop = (VIEWS.names[0], VIEWS[0].size[0] / 2, 4.0)
    with pytest.raises(StyleSplatError, match="nothing behind it"):
        select(scene, "backdrop", point=backdrop)
    found = select(scene, "it", point=at(CENTRES[2])).objects["it"].mask
    assert agreement(found[: len(MEANS)], 2) > 0.7


def masked(scene: Scene, of: torch.Tensor) -> Bool[torch.Tensor, " N"]:
    """What is picked where the upper half of an object is masked, and nothing beside it belongs."""
    shown = coverage(scene.splats, VIEWS[0], of) > 0.5
    low, high = (edge.tolist() for edge in shown.nonzero().aminmax(dim=0))
    outside = torch.ones_like(shown)
    outside[low[0] : high[0] + 1, low[1] : high[1] + 1] = False
    shown[(low[0] + high[0]) // 2 :] = False
    return pick_masked(scene.splats, VIEWS, [(0, shown, outside)])


def test_a_masked_object_is_completed_and_ends_where_it_leans():
    assert agreement(masked(BARE, OF == 0), 0) > 0.7
    assert agreement(masked(BARE, OF == 2), 2) > 0.7


def test_a_box_decides_where_its_cut_misses_half_of_the_object():
    both, half = (
        coverage(BARE.splats, VIEWS[0], each) > 0.5 for each in ((OF == 0) | (OF == 1), OF == 0)
    )
    (top, left), (bottom, right) = (edge.tolist() for edge in both.nonzero().aminmax(dim=0))
    drawn = torch.zeros_like(both)
    drawn[top : bottom + 1, left : right + 1] = True
    found, _ = pick_in_boxes(BARE.splats, VIEWS, {0: drawn}, {0: half})
    assert agreement(found, 0, 1) > 0.7


def test_a_box_of_most_of_a_photo_does_not_hold_all_that_is_beside_it():
    splats = under_a_dome()
    own = torch.zeros(len(splats), dtype=torch.bool)
    own[: len(MEANS)] = (OF == 0) | (OF == 1)
    cut = coverage(splats, VIEWS[0], own) > 0.5
    drawn = torch.zeros_like(cut)
    drawn[4:-4, 4:-4] = True
    found, _ = pick_in_boxes(splats, VIEWS, {0: drawn}, {0: cut})
    assert found[len(MEANS) :].float().mean() < 0.1


def test_what_fails_in_one_pick_is_no_worse_pick():
    """Picks of nothing are left out, but other errors are told."""

    class Stopping(Observer):
        def task(
            self, what: str, total: float | None, unit: str, done: float
        ) -> AbstractContextManager[Task]:
            raise StyleSplatError(f"stopped while {what}")

    splats = replace(BARE.splats, sh0=BARE.splats.sh0 + 0.1)  # of which nothing is cached
    _, x, y = at(CENTRES[0])
    cut = torch.zeros(*VIEWS[0].size[::-1], dtype=torch.bool)
    cut[int(y) - 8 : int(y) + 8, int(x) - 8 : int(x) + 8] = True
    drawn = torch.zeros_like(cut)
    drawn[int(y) - 10 : int(y) + 10, int(x) - 10 : int(x) + 10] = True
    with observed(Stopping()), pytest.raises(StyleSplatError, match="stopped while"):
        pick_in_boxes(splats, VIEWS, {0: drawn}, {0: cut})


def test_picking_keeps_no_splat_alive():
    splats = BARE.splats.map(torch.clone)
    known = ref(splats), ref(splats.means)
    scene = select(Scene(splats, VIEWS), "it", point=at(CENTRES[0]))
    masked(scene, OF == 0)
    del splats, scene
    gc.collect()
    assert known[0]() is None and known[1]() is None


def test_a_masked_object_reaches_down_to_what_it_stands_on():
    angles, heights = torch.linspace(0, 2 * torch.pi, 40), torch.linspace(0.03, 0.8, 30)
    sides = torch.cartesian_prod(angles, heights)
    can = torch.stack([0.4 * sides[:, 0].cos(), 0.4 * sides[:, 0].sin(), sides[:, 1]], dim=1)
    means = torch.cat([F.pad(TABLE, (0, 1)), can])
    of = torch.arange(len(means)) >= len(TABLE)
    found = masked(Scene(cloud(means, 0.03, opacity=3.0), VIEWS), of)
    low = of & (means[:, 2] < 0.15) & (means[:, 2] > 0.06)
    assert found[low].float().mean() > 0.8 and found[of].float().mean() > 0.8
    assert found[~of].float().mean() < 0.02, "the table is not taken"


def test_a_bed_that_leaves_the_photos_is_not_taken_with_what_lies_on_it():
    """It is no plane, and its outline shows nowhere."""
    x, y = (2 * TABLE).unbind(dim=1)
    bed, ball = (
        torch.stack([x, y, -0.3 * x**2], dim=1),
        1.5 * SHELL + CENTRES.new_tensor([0, 0, 0.35]),
    )
    scene = Scene(cloud(torch.cat([bed, ball]), 0.06, opacity=3.0), VIEWS)
    found = select(scene, "it", point=at((0.0, 0.0, 0.35))).objects["it"].mask
    wanted = torch.arange(len(found)) >= len(bed)
    assert float((found & wanted).sum() / (found | wanted).sum()) > 0.7
