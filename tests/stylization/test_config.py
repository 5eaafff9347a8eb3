from dataclasses import asdict, replace
from typing import Any

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.config import (
    FINEST,
    GROWTH,
    LEAST,
    MANY_DISCS,
    MOST_GROWTH,
    PLANS,
    PRESETS,
    WINDOW,
    Quality,
    Stage,
    StyleConfig,
)
from stylesplat.stylization.style import Style


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"steps": 0}, "steps 0: use 1 to 1,000,000"),
        ({"steps": 10**7}, "steps 10000000: use"),
        ({"scale": -1.0}, r"scale -1\.0: use 0\.001 to 10,000"),
        ({"scale": float("inf")}, "with scale inf"),
        ({"lr": float("nan")}, "lr nan"),
        ({"object_size": 10**400}, "object_size 10+: use 1 to 10,000"),
        ({"intensity": 1.6}, r"intensity 1\.6: use 0 to 1\.5"),
        ({"form": -0.1}, r"form -0\.1: use 0 to 1\.5"),
        ({"content": -0.1}, r"content -0\.1: use 0 to"),
        ({"rotate": float("nan")}, "with rotate nan"),
        ({"seed": -(10**400)}, "seed -10+: use"),
        ({"layers": ()}, "name some of 1 to 4"),
        ({"layers": (3, 5)}, "name some of 1 to 4"),
    ],
)
def test_settings_out_of_range(settings: dict[str, Any], message: str):
    with pytest.raises(StyleSplatError, match=message):
        StyleConfig(**settings)


PUBLISHED = {
    "steps": 500,  # section 4, implementation details: 500 to 1,000 iterations
    "published": True,  # sections 3.4 and 4: all bands, every picked Gaussian, 25 % of the views
    "color": "free",  # section 3.4: the NNFM loss alone, no transfer of colours
    "content": 0.0,  # section 3.4: no other loss
    "form": 0.0,
    "intensity": 1.0,  # section 4, scale control: intensity is the learning rate
    "lr": 0.0025,  # the official code, which keeps 3D Gaussian splatting's feature_lr
    "layers": (3,),  # ARF (Zhang et al. 2022), section 4: conv3, which the official code keeps
    "object_size": None,
    "rotate": 0.0,
    "region": None,
}


def test_the_papers_preset_is_the_method_as_published():
    paper = PRESETS["paper"]
    assert {name: asdict(paper)[name] for name in PUBLISHED} == PUBLISHED
    assert paper.max_discs(1000) == 0, "section 3.4: nothing but colours changes"
    assert paper.pattern_removed == 0
    assert paper.stages(321.0) == [Stage(321.0, 500)], "seen whole, as large as in the photos"
    style = Style("wave.jpg", preset="paper")  # section 3.4: VGG features; VGG16 in the code
    assert (style.config, style.network) == (paper, "vgg16")
    assert Style("wave.jpg").network == "compact"


def test_the_own_pattern_goes_as_far_as_content_is_not_kept():
    configs = [StyleConfig(content=content) for content in (0.0, 0.25, 1.0, 2.0)]
    assert [config.pattern_removed for config in configs] == [1, 0.75, 0, 0]
    assert StyleConfig(color="free").pattern_removed == 0, "colours start where they are"


@pytest.mark.parametrize("quality", PLANS)
@pytest.mark.parametrize("steps", [1, 2, 3, 300, None])
@pytest.mark.parametrize("scale", [0.01, 2.0, 100.0])
def test_stages_use_up_the_steps_and_grow_within_bounds(
    quality: Quality, steps: int | None, scale: float
):
    config = StyleConfig(quality=quality, steps=steps, scale=scale)
    stages = config.stages(500.0)
    assert sum(stage.steps for stage in stages) == config.all_steps == (steps or config.all_steps)
    assert all(stage.steps > 0 for stage in stages)
    lengths = [stage.length for stage in stages]
    assert lengths == sorted(lengths) and min(lengths) >= LEAST and max(lengths) <= 500
    if quality == "normal" and steps is None:
        assert lengths[-1] == 500, "large strokes have edges as sharp as others"
    tiny = replace(config, object_size=20, steps=None).stages(500.0)
    assert max(stage.length for stage in tiny) == 20


def test_qualities_end_at_their_sizes_with_as_many_discs():
    configs = [StyleConfig(quality=quality) for quality in PLANS]
    assert [config.stages(500.0)[-1].length for config in configs] == [160, 500, 500]
    fine = [configs[-1].stages(length)[-1].length for length in (100.0, 200.0, 4000.0)]
    assert fine == [160, 200, FINEST], "the photos' length, within bounds"
    steps = [config.all_steps for config in configs]
    assert steps == sorted(steps)
    discs = [config.max_discs(100_000) for config in configs]
    assert discs == [0, (GROWTH - 1) * 100_000, (GROWTH - 1) * 100_000]
    assert StyleConfig().max_discs(MANY_DISCS // 5) == MANY_DISCS
    assert StyleConfig().max_discs(1_000) == (MOST_GROWTH - 1) * 1_000


def test_sizes_follow_the_scale():
    """Beside a style image of the same size: an object half as long shows strokes twice as large.
    Fine stages render it at the photos' size: there it is the style image that becomes larger."""
    usual, large, small = (StyleConfig(scale=scale).stages(500.0) for scale in (2.0, 4.0, 1.0))
    usual_lengths, large_lengths, small_lengths = (
        [stage.length for stage in stages] for stages in (usual, large, small)
    )
    assert large_lengths[:2] == [length / 2 for length in usual_lengths[:2]]
    assert large_lengths[2:] == usual_lengths[2:]
    coarse = [2 * length for length in usual_lengths if length <= 160]
    assert small_lengths[: len(coarse)] == coarse
    assert usual_lengths[-1] == small_lengths[-1] == 500
    assert small_lengths == sorted(small_lengths)
    assert usual[0].window is None and usual[-1].window == WINDOW
    assert {stage.window for stage in small} == {WINDOW}, "no step costs more than usual"
    assert [stage.fine for stage in (small[0], small[-1])] == [False, True]
