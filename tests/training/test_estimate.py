"""The line that says how long training will take."""

from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
import torch

from stylesplat.progress import Observer, observed
from stylesplat.scene.capture import Capture
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit

STEPS = 400  # enough for an estimate


class Stopped(Exception):
    pass


class Lines(Observer):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, line: str) -> None:
        self.lines.append(line)


def lines_at_start(capture: Capture, config: TrainConfig, **options) -> str:
    """What a run says before its first report, where it is stopped."""

    def stop(*_: object) -> None:
        raise Stopped

    with observed(listener := Lines()), pytest.raises(Stopped):
        fit(capture, config, on_progress=stop, **options)
    return "\n".join(listener.lines)


def test_the_line_says_what_is_trained_and_how_long_it_takes(
    capture: Capture, config: TrainConfig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    clock, kept = count(), {"checkpoint": tmp_path / "checkpoint.pt"}
    monkeypatch.setattr("time.perf_counter", lambda: float(next(clock)))  # each round takes 1 s
    line = lines_at_start(capture, replace(config, steps=STEPS, photos_at_once=1), **kept)
    for fact in ("7 photos of 72x64", "400 Gaussians", "400 steps", "about 7 min", "softer"):
        assert fact in line
    assert "`--max-seconds 60 --max-gaussians 50000` gives a first look" in line
    line = lines_at_start(capture, replace(config, steps=5200, photos_at_once=2), **kept)
    assert "5,200 steps take about 43 min" in line and "softer" not in line
    long, small = replace(config, steps=40_000), replace(capture, downscale=2.0)
    line = lines_at_start(small, long, **kept)
    assert "about 5.6 h" in line and "All pixels of the photos would take up to 22.2 h" in line
    line = lines_at_start(small, long)
    assert "about 5.6 h" in line and "All pixels" not in line, "others have no options of `train`"


def test_the_line_is_left_out_where_the_time_is_known_or_short(
    capture: Capture, config: TrainConfig
):
    assert "take about" in lines_at_start(capture, replace(config, steps=STEPS))
    assert "take about" not in lines_at_start(capture, replace(config, steps=STEPS - 1))
    timed = replace(config, steps=STEPS, max_seconds=5.0)
    assert "take about" not in lines_at_start(capture, timed)


def test_the_estimate_changes_nothing_in_the_run(capture: Capture, config: TrainConfig):
    """Equal first steps, with the estimate of a run that is long enough and without."""
    config, found = replace(config, color_correction="on"), []
    for steps in (STEPS, STEPS - 1):

        def keep(state, *_: object) -> None:
            found.append({name: t.detach().clone() for name, t in state.params.items()})
            raise Stopped

        with pytest.raises(Stopped):
            fit(capture, replace(config, steps=steps), on_progress=keep)
    with_estimate, without = found
    assert with_estimate.keys() == without.keys() >= {"means", "color_maps"}
    for name in without:  # rates differ a little with the length
        assert torch.allclose(with_estimate[name], without[name], rtol=0, atol=1e-5), name
