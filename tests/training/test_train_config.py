from dataclasses import fields, replace

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.training.train_config import PRESETS, TrainConfig


@pytest.mark.parametrize("name", ["steps", "max_gaussians", "refine_every"])
@pytest.mark.parametrize("value", [0, -1])
def test_there_has_to_be_something_to_do(name: str, value: int):
    with pytest.raises(StyleSplatError, match=f"Cannot train with {name} {value}"):
        replace(TrainConfig(), **{name: value})


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_time_is_positive(value: float):
    with pytest.raises(StyleSplatError, match="max_seconds"):
        TrainConfig(max_seconds=value)


@pytest.mark.parametrize("value", [-0.1, float("nan")])
def test_memory_is_not_negative(value: float):
    assert TrainConfig(max_memory=0.0).max_memory == 0
    with pytest.raises(StyleSplatError, match="Cannot train with max_memory"):
        TrainConfig(max_memory=value)


def test_the_default_preset_is_the_default():
    assert PRESETS["default"] == TrainConfig()


def test_presets_differ_in_what_they_are_meant_to_only():
    assert PRESETS["paper"] != TrainConfig()
    assert replace(PRESETS["paper"], seed=5).steps == 30_000
    assert PRESETS["paper"].max_memory == TrainConfig().max_memory
    assert PRESETS["paper"].test_every == TrainConfig().test_every


def test_every_setting_says_what_it_is():
    # The command line makes its help of these.
    source = __import__("inspect").getsource(TrainConfig)
    for field in fields(TrainConfig):
        after = source.split(f"    {field.name}:")[1].splitlines()[1]
        assert after.strip().startswith('"""'), field.name
