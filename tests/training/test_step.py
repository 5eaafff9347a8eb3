"""One step: what is compared, and whom the gradients reach."""

from collections.abc import Iterator
from dataclasses import replace

import numba
import pytest
import torch

from processes import begun
from scenes import random_splats
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.view_pool import RenderPool
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import scene_extent
from stylesplat.scene.projection import depths_of
from stylesplat.training.config import TrainConfig
from stylesplat.training.densification import MCMCStrategy
from stylesplat.training.losses import depth_phases, depth_scatter
from stylesplat.training.state import State, TrainingRun, first_state
from stylesplat.training.step import (
    STEP_NEIGHBORS,
    apply_gradients,
    photo_gradients,
    pulls_depths,
    train_step,
)
from stylesplat.training.views import TrainingViews

GEOMETRY = ("means", "quats", "scales", "opacities")


def gradients(capture: Capture, config: TrainConfig, step: int = 0) -> dict[str, torch.Tensor]:
    run, state = begun(capture, config)
    found = photo_gradients(run, state, step).state.params
    return {name: t.grad for name, t in found.items() if t.grad is not None}


@pytest.fixture
def config() -> TrainConfig:
    return TrainConfig(coarse_to_fine=False, identity_every=2)


def test_the_identity_loss_moves_no_geometry_unless_asked(capture: Capture, config: TrainConfig):
    plain = gradients(replace(capture, label_maps=None), config)
    joint, between = gradients(capture, config), gradients(capture, config, step=1)
    moving = gradients(capture, replace(config, identity_geometry=True))
    assert joint.keys() - between.keys() == {"identities", "weight", "bias"}, "every second step"
    for name in (*GEOMETRY, "sh0"):
        # The same sums in another order.
        assert (joint[name] - plain[name]).norm() < 1e-4 * plain[name].norm(), name
    for name in GEOMETRY:
        if name != "quats":  # of round Gaussians
            assert (moving[name] - plain[name]).norm() > 1e-2 * plain[name].norm(), name


def test_masked_pixels_have_no_gradients_of_colours_and_labels(
    capture: Capture, config: TrainConfig
):
    valid = torch.ones(64, 72, dtype=torch.bool)
    valid[:, :40] = False
    masks = [valid] * len(capture)
    photos = [photo.where(valid[..., None], 255) for photo in capture.photos]
    maps = [capture.labels(row) for row in range(len(capture))]
    others = [None if each is None else each.where(valid, 3) for each in maps]
    plain = gradients(replace(capture, valid_masks=masks), config)
    changed = replace(capture, photos=photos, label_maps=others, valid_masks=masks)
    for name, gradient in gradients(changed, config).items():
        assert torch.equal(gradient, plain[name]), name


def test_a_step_leaves_what_nobody_sees(capture: Capture, config: TrainConfig):
    run, state = begun(replace(capture, label_maps=None), config)
    with torch.no_grad():
        state.params["means"][:10] += 100
        state.params["opacities"][:10] = 5.0  # no noise either
    visible = photo_gradients(run, state, 0).visible
    assert not visible[:10].any() and visible[10:].all()
    before = state.clone()
    after, _ = train_step(run, state)
    for name in state.names:
        assert torch.equal(after.params[name][:10], before.params[name][:10]), name
        assert not after.moments.first[name][:10].any()
        if name not in ("quats", "shN"):  # of round Gaussians, of bands not in use yet
            assert not torch.equal(after.params[name][10:], before.params[name][10:]), name


def test_later_steps_draw_what_a_pixel_mixes_to_one_depth(capture: Capture):
    capture = replace(capture, label_maps=None)
    drawn = TrainConfig(steps=100, coarse_to_fine=False, scatter_weight=0.5)
    plain = replace(drawn, scatter_weight=0.0)
    run, state = begun(capture, drawn)
    assert [step for step in range(44) if pulls_depths(run, replace(state, step=step))] == [41, 43]
    with_loss, without = (gradients(capture, config, step=41) for config in (drawn, plain))
    with torch.no_grad():
        for name in GEOMETRY:
            state.params[name] -= 0.1 * (with_loss[name] - without[name])
    camera, before = capture.cameras[run.row(41)], begun(capture, drawn)[1]

    def scatter(state: State) -> float:
        splats = state.splats.detach()
        phases = depth_phases(depths_of(splats.means, camera))
        shown, alphas, _ = rasterize(splats, camera, features=phases)
        return float(depth_scatter(shown[0, ..., 3:], alphas[0]))

    assert scatter(state) < scatter(before)
    strays = {name: (with_loss[name] - without[name]).abs().max() for name in ("sh0", "shN")}
    assert max(strays.values()) < 1e-6, "colours follow the photos alone"


def test_growth_comes_at_the_end_of_its_interval(capture: Capture, config: TrainConfig):
    settings = {"steps": 100, "refine_every": 10, "max_gaussians": 200}
    run, state = begun(capture, replace(config, **settings))
    counts = [
        len(train_step(run, replace(state.clone(), step=step))[0].splats)
        for step in (8, 9, 10, 19, 89, 99)
    ]
    first = len(state.splats)
    assert counts[0] == counts[2] == first < counts[1] < counts[3] <= 200
    assert counts[4] == 200 and counts[5] == first, "nothing is added in the last tenth"


def test_fewer_gaussians_than_neighbours_still_train(capture: Capture, config: TrainConfig):
    run, state = begun(capture, config)
    few = first_state(state.splats.detach()[torch.arange(STEP_NEIGHBORS)])
    after, scores = train_step(run, few)
    assert scores.isfinite().all() and len(after.splats) == STEP_NEIGHBORS


@pytest.mark.parametrize("cut_out", [False, True])
def test_photos_without_anything_of_their_own_teach_the_same(
    capture: Capture, config: TrainConfig, cut_out: bool
):
    assert capture.label_maps is not None
    covered = [255 * (x > 0).to(torch.uint8) for x in capture.label_maps if x is not None]
    photos = [photo.clamp(max=200) for photo in capture.photos]  # nothing is blown out
    alphas = covered if cut_out else None
    run, state = begun(replace(capture, photos=photos, label_maps=None, alphas=alphas), config)
    zeros = {"color_maps": torch.zeros(9, 3, 4), "pose_shifts": torch.zeros(9, 6)}
    learning = state.clone().with_photos(zeros)
    one, two = (photo_gradients(run, each, 0) for each in (state, learning))
    assert torch.allclose(one.scores, two.scores, rtol=1e-5)
    learned = two.state.params
    for name, param in one.state.params.items():
        other = learned[name].grad
        assert param.grad is not None and other is not None
        # Colours are put over the background in another order
        assert (other - param.grad).norm() <= 1e-3 * param.grad.norm(), name
    for name in zeros:
        own = learned[name].grad
        assert own is not None and own[run.row(0)].any()
        assert int(own.flatten(1).any(dim=1).sum()) == 1


@pytest.fixture
def one_thread(all_cores: None) -> Iterator[int]:
    """As each of two threads has it that share two cores; yields how many there are else."""
    before = numba.get_num_threads(), torch.get_num_threads()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    yield before[0]
    numba.set_num_threads(before[0])
    torch.set_num_threads(before[1])


def after(run: TrainingRun, state: State, rounds: int) -> State:
    state = state.clone()
    for _ in range(rounds):
        state, _ = train_step(run, state)
    return state


def is_same(one: State, other: State) -> bool:
    pairs = zip(one.params.values(), other.params.values(), strict=True)
    return one.step == other.step and all(torch.equal(a, b) for a, b in pairs)


def test_threads_change_nothing(capture: Capture, config: TrainConfig, one_thread: int):
    config = replace(config, refine_poses=True, color_correction="on")
    run, state = begun(capture, config, 4, of_photos=True)
    alone = after(run, state, 3)
    numba.set_num_threads(min(one_thread, 2))
    pool = RenderPool(4)
    try:
        assert pool.size == numba.get_num_threads()
        assert is_same(after(replace(run, pool=pool), state, 3), alone)
    finally:
        pool.end()
    assert alone.step == 12


def test_gradients_of_a_round_are_of_one_state_and_steps_in_turn(
    capture: Capture, config: TrainConfig
):
    run, state = begun(capture, config, 2, of_photos=True)
    together, one, other = after(run, state, 1), state.clone(), state.clone()
    found = [[photo_gradients(run, start, step) for step in (0, 1)] for start in (one, other)]
    apply_gradients(run, found[0])
    for each in found[1]:
        apply_gradients(run, [each])
    assert is_same(one, other)
    for name, each in one.params.items():
        # Noise comes after the steps of a round
        assert torch.equal(each, together.params[name]) == (name != "means"), name
    assert not is_same(after(replace(run, batch=1), state, 2), together)


# The order of photos and steps.


def run_on(cameras, *, rows=tuple(range(1, 9)), **settings) -> TrainingRun:
    config, black = TrainConfig(**settings), [torch.zeros(64, 72, 3).byte()] * len(cameras)
    return TrainingRun(
        config=config,
        rows=rows,
        views=TrainingViews(Capture(cameras, black), rows, ids=(), device=torch.device("cpu")),
        cameras=cameras,
        extent=scene_extent(cameras),
        device=torch.device("cpu"),
        strategy=MCMCStrategy(config, scene_extent(cameras)),
    )


def test_each_photo_comes_once_per_epoch_in_an_order_that_follows_from_the_step(cameras):
    here = run_on(cameras)
    for epoch in range(5):
        rows = [here.row(8 * epoch + place) for place in range(8)]
        assert sorted(rows) == list(range(1, 9))
    forth = [run_on(cameras).row(step) for step in range(24)]
    back = [run_on(cameras).row(step) for step in reversed(range(24))]
    assert forth == back[::-1]
    firsts = {run_on(cameras, seed=seed).row(0) for seed in range(60)}
    assert firsts == set(range(1, 9))  # each is missed with a chance of (7/8)^60, 3 in 10,000
    seeds = {
        run_on(cameras, seed=s).generator(n).initial_seed() for s in range(5) for n in range(5)
    }
    assert len(seeds) == 25


def test_a_round_takes_the_next_steps(cameras):
    here, state = replace(run_on(cameras, steps=11), batch=4), first_state(random_splats(5))

    def rounds(here: TrainingRun) -> list[list[int]]:
        return [[*here.own_steps(replace(state, step=step))] for step in (0, 4, 8)]

    assert rounds(here) == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10]]
    timed = replace(here, config=replace(here.config, max_seconds=9.0))
    assert rounds(timed)[-1] == [8, 9, 10, 11]
    shares = [timed.progress(replace(state, step=1000, seconds=s)) for s in (0.0, 4.5, 9.0, 10.0)]
    assert shares == [0, 0.5, 1, 1]
    assert [here.is_due(2, step) for step in range(12)] == [True] * 4 + [False] * 4 + [True] * 4
