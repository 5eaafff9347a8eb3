"""The size of photos that training takes an acceptable time on."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from scenes import random_splats
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.training import photo_size
from stylesplat.training.config import TRAIN_PRESETS, TrainConfig
from stylesplat.training.photo_size import (
    affordable_downscale,
    for_larger_views,
    usual_downscale,
    widened,
)

CPU = torch.device("cpu")


@pytest.fixture
def large(capture: Capture) -> Callable[[float], Capture]:
    """The capture as if its photos had 3,600 pixels."""
    cameras = replace(capture.cameras, sizes=capture.cameras.sizes * 50, Ks=capture.cameras.Ks * 50)
    return lambda factor: replace(capture, cameras=cameras.downscale(factor))


@pytest.mark.parametrize(
    ("a_step", "a_pixel", "max_seconds", "side"),
    [
        (0.0, 300 / 1200**2, None, 1200),  # all of the time is for pixels
        (150.0, 150 / 900**2, None, 900),  # half of it
        (0.0, 300 / 1200**2, 75.0, 600),  # a quarter of the time
        (0.0, 1e-9, None, 1600),  # a GPU
        (500.0, 1e-3, None, 480),  # nothing fits
        (9.0, 0.0, None, 1600),  # all is lost in noise
    ],
)
def test_photos_are_as_large_as_the_time_allows(
    large: Callable[[float], Capture],
    monkeypatch: pytest.MonkeyPatch,
    a_step: float,
    a_pixel: float,
    max_seconds: float | None,
    side: int,
):
    def seconds(capture: Capture, *_: object) -> Tensor:
        whole_run = a_step + a_pixel * int(capture.cameras.sizes.max()) ** 2
        return torch.full((4,), whole_run / TrainConfig.steps)

    monkeypatch.setattr(photo_size, "_step_seconds", seconds)
    factor = affordable_downscale(large, TrainConfig(max_seconds=max_seconds), device=CPU)
    assert 3600 / side <= factor < 3600 / side + 0.27 and factor * 4 == int(factor * 4)


def test_a_run_with_a_time_takes_many_of_its_quick_steps(
    large: Callable[[float], Capture], monkeypatch: pytest.MonkeyPatch
):
    def seconds(capture: Capture, *_: object) -> Tensor:
        area = int(capture.cameras.sizes.max()) ** 2
        return torch.tensor([1.0, 9.0]) / 5 * 299 / 1200**2 * area / TrainConfig.steps

    monkeypatch.setattr(photo_size, "_step_seconds", seconds)
    by_steps = affordable_downscale(large, TrainConfig(), device=CPU)
    by_time = affordable_downscale(large, TrainConfig(max_seconds=300.0), device=CPU)
    assert (by_steps, by_time) == (3.0, 2.25), "2.8 times the steps at 1200 pixels"


def test_a_moment_of_noise_promises_no_speed(
    large: Callable[[float], Capture], monkeypatch: pytest.MonkeyPatch
):
    """What was measured as larger photos were tried, and smaller ones a moment before."""

    def seconds(capture: Capture, *_: object) -> Tensor:
        side = int(capture.cameras.sizes.max())
        even = torch.full((10,), 300 / TrainConfig.steps * (side / 600) ** 2)
        even[3] *= 6 if side < 600 else 1
        return even

    monkeypatch.setattr(photo_size, "_step_seconds", seconds)
    assert affordable_downscale(large, TrainConfig(max_seconds=300.0), device=CPU) >= 6
    assert affordable_downscale(large, TrainConfig(), device=CPU) >= 6


def test_the_time_is_measured_with_the_settings_of_a_run_that_has_one(
    large: Callable[[float], Capture], monkeypatch: pytest.MonkeyPatch
):
    asked = list[int]()

    def seconds(_capture: Capture, config: TrainConfig, _device: torch.device) -> Tensor:
        asked.append(config.max_gaussians)
        return torch.ones(4)

    monkeypatch.setattr(photo_size, "_step_seconds", seconds)
    affordable_downscale(large, TrainConfig(max_seconds=9.0, max_gaussians=7), device=CPU)
    affordable_downscale(large, TRAIN_PRESETS["paper"], device=CPU)
    assert asked == [7, 7, 100_000, 100_000]


def test_small_photos_are_trained_on_as_they_are(capture: Capture, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(photo_size, "_step_seconds", None)  # nothing is measured
    assert affordable_downscale(lambda _: capture, TrainConfig(), device=CPU) == 1


@pytest.mark.parametrize(
    ("photos", "trained", "painted"),
    [(3600, 7.5, 3.75), (3600, 3.75, 3.75), (3600, 2.0, 2.0), (960, 1.0, 1.0), (1000, 2.0, 1.0)],
)
def test_scenes_are_painted_larger_than_they_were_trained(
    large: Callable[[float], Capture], photos: int, trained: float, painted: float
):
    scene = Scene(random_splats(9), large(3600 / photos).cameras, downscale=trained)
    wide = for_larger_views(scene)
    assert wide.downscale == painted
    assert (wide.base is scene.base) == (trained == painted)


def test_larger_views_show_splats_as_wide_as_they_were_trained(capture: Capture):
    full = replace(
        capture.cameras,
        sizes=capture.cameras.sizes * 3,
        Ks=torch.diag(torch.tensor([3.0, 3.0, 1.0])) @ capture.cameras.Ks,
    )
    splats = random_splats(60, seed=2)
    splats.means.mul_(0.1)  # as far from all cameras, by and large
    splats.scales.sub_(3)  # thinner than pixels

    def differs(shown: Splats) -> float:
        """From what training showed, at the centres of its pixels."""
        trained = rasterize(splats, full.downscale(3)[0])[0][0]
        return float((rasterize(shown, full[0])[0][0, 1::3, 1::3] - trained).abs().mean())

    assert differs(widened(splats, full, 3.0)) < 0.2 * differs(splats)


def test_processes_take_what_no_machine_decides(large: Callable[[float], Capture]):
    assert usual_downscale(large(1).cameras) == 2.25
    assert usual_downscale(large(3).cameras) == 1
