"""Training with strategies of others: gsplat's interface, and gsplat's own on the CPU."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
import torch

import fake_gsplat
from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.io.splats.splat_ply import splat_fault
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import scene_extent
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit
from stylesplat.training.state import State
from stylesplat.training.views import split_views

PER_GAUSSIAN = {"means", "quats", "scales", "opacities", "sh0", "shN", "identities"}


@pytest.fixture
def config(config: TrainConfig) -> TrainConfig:
    return replace(config, photos_at_once=None, coarse_to_fine=False)


@pytest.fixture(autouse=True)
def same_random_numbers() -> Iterator[None]:
    """gsplat's strategies draw from the global generator."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        yield


@dataclass
class Recorder:
    """Changes nothing and remembers its calls."""

    calls: list[tuple[str, int]] = field(default_factory=list)
    rates: list[float] = field(default_factory=list)
    extra_loss: float = 0.0

    def initialize_state(self, scene_scale: float) -> dict[str, Any]:
        return {"steps": 0, "scale": scene_scale}

    def step_pre_backward(self, params, optimizers, state, step, info) -> None:
        assert params.keys() == optimizers.keys() == PER_GAUSSIAN
        info["means2d"].retain_grad()
        info["loss"] = info["loss"] + self.extra_loss
        self.calls.append(("before", step))

    def step_post_backward(self, params, optimizers, state, step, info, lr) -> None:
        state["steps"] += 1
        count = len(params["means"])
        for name, optimizer in optimizers.items():
            ((param,),) = (group["params"] for group in optimizer.param_groups)
            assert param is params[name]
            assert all(len(each) == count for each in optimizer.state[param].values())
        assert info["means2d"].grad.shape == (1, count, 2)
        assert info["means2d"].grad[info["radii"].sum(dim=-1) > 0].any()
        assert (info["width"], info["height"]) == (72, 64) and info["n_cameras"] == 1
        assert info["round"] == range(step, step + 1) and info["photos"] == 1
        self.calls.append(("after", step))
        self.rates.append(lr)


def test_a_strategy_has_its_turn_before_and_after_each_photo(capture: Capture, config: TrainConfig):
    losses = []
    for extra in (0.0, 2.0):
        recorder, reported = Recorder(extra_loss=extra), []
        state = fit(
            capture,
            replace(config, steps=6),
            strategy=recorder,
            on_progress=lambda _, loss, __, to=reported: to.append(loss),
        )
        turns = [(turn, step) for step in range(6) for turn in ("before", "after")]
        assert recorder.calls[-12:] == turns, "those before are of the warm-up"
        assert state.strategy_state == {"steps": 6, "scale": scene_extent(capture.cameras)}
        assert recorder.rates[-6:] == sorted(recorder.rates[-6:], reverse=True)
        assert state.step == 6 and len(state.splats) == state.first_count
        losses.append(torch.tensor(reported))
    torch.testing.assert_close(losses[1] - losses[0], torch.full((6,), 2.0))


class Chaser(Recorder):
    """Throws Gaussians out of all bounds after the third step."""

    def step_post_backward(self, params, optimizers, state, step, info, lr) -> None:
        if step == 2:
            with torch.no_grad():
                params["means"][:7] = 1e12
                params["sh0"][7:9] = torch.nan


def test_gaussians_that_ran_away_are_left_out_of_what_is_finished(
    capture: Capture, config: TrainConfig, said: list[str]
):
    state = fit(capture, replace(config, steps=3), strategy=Chaser())
    splats = state.splats.detach()
    assert len(splats) == state.first_count - 9 and splat_fault(splats) is None
    assert all(len(state.moments.second[name]) == len(splats) for name in state.names)
    assert [line for line in said if "9 Gaussians ran away" in line]


def held_out_psnr(state: State, capture: Capture, config: TrainConfig) -> float:
    assert all(len(state.moments.first[name]) == len(state.splats) for name in state.names)
    _, held_out = split_views(capture, config.test_every)
    return evaluate_views(state.splats.detach(), replace(capture, label_maps=None), held_out)[
        "psnr"
    ]


def test_gsplats_default_strategy_splits_and_prunes(capture: Capture, config: TrainConfig):
    gsplat = pytest.importorskip("gsplat")
    config, counts = replace(config, steps=60, max_gaussians=100), []
    settings = {"refine_start_iter": 5, "refine_every": 10, "refine_stop_iter": 45}
    for limits in ({"grow_grad2d": 0.01}, {"grow_grad2d": 1e9, "prune_opa": 0.05}):
        counts.append([])
        state = fit(
            capture,
            config,
            strategy=gsplat.DefaultStrategy(**settings, **limits),
            on_progress=lambda state, *_: counts[-1].append(len(state.splats)),
        )
        changes = {step + 1 for step in range(59) if counts[-1][step + 1] != counts[-1][step]}
        assert changes and changes <= {10, 20, 30, 40}
        assert held_out_psnr(state, capture, config) > 17
    (first, *_, grown), (*_, pruned) = counts
    assert pruned < first == 100 < grown


def test_gsplats_mcmc_strategy_grows_and_moves(
    capture: Capture, config: TrainConfig, monkeypatch: pytest.MonkeyPatch
):
    gsplat = pytest.importorskip("gsplat")
    fake_gsplat.install_training_kernels(monkeypatch)
    config = replace(config, steps=60, max_gaussians=100)
    settings = {"cap_max": 110, "refine_start_iter": 5, "refine_every": 10}
    splats = []
    for noise in (0.0, 5e4):
        state = fit(capture, config, strategy=gsplat.MCMCStrategy(**settings, noise_lr=noise))
        assert len(state.splats) == 110
        assert held_out_psnr(state, capture, config) > 15
        splats.append(state.splats)
    assert not torch.equal(splats[0].means, splats[1].means)


def test_what_other_strategies_cannot_do_is_refused(
    capture: Capture, config: TrainConfig, tmp_path
):
    with pytest.raises(StyleSplatError, match="checkpoint"):
        fit(capture, config, strategy=Recorder(), checkpoint=tmp_path / "run.pt")
    with pytest.raises(StyleSplatError, match="several photos"):
        fit(capture, replace(config, photos_at_once=2), strategy=Recorder())
