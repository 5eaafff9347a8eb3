"""The size of photos that training takes an acceptable time on."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from stylesplat.scene.capture import Capture
from stylesplat.training import photo_size
from stylesplat.training.photo_size import (
    affordable_downscale,
    painting_downscale,
    usual_downscale,
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
    def seconds(capture: Capture, _: torch.device) -> float:
        return a_step + a_pixel * int(capture.cameras.sizes.max()) ** 2

    monkeypatch.setattr(photo_size, "_seconds_at", seconds)
    factor = affordable_downscale(large, device=CPU, max_seconds=max_seconds)
    assert 3600 / side <= factor < 3600 / side + 0.27 and factor * 4 == int(factor * 4)


def test_small_photos_are_trained_on_as_they_are(capture: Capture, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(photo_size, "_seconds_at", None)  # nothing is measured
    assert affordable_downscale(lambda _: capture, device=CPU) == 1


def test_scenes_are_painted_larger_than_they_were_trained(large: Callable[[float], Capture]):
    views = large(1).cameras
    assert [painting_downscale(views, trained) for trained in (7.5, 3.75, 2.0)] == [3.75, 3.75, 2.0]
    assert painting_downscale(large(3.75).cameras, 1.0) == 1.0
    assert painting_downscale(large(3.6).cameras, 2.0) == 1.0, "all of 1,000 pixels, not 800"


def test_processes_take_what_no_machine_decides(large: Callable[[float], Capture]):
    assert usual_downscale(large(1).cameras) == 2.25
    assert usual_downscale(large(3).cameras) == 1
