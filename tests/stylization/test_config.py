from dataclasses import asdict, replace
from typing import Any

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.config import LEAST, PLANS, STYLE_PRESETS, Quality, Stage, StyleConfig
from stylesplat.stylization.style import Style


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"steps": 0}, "steps 0: use 1 to 1,000,000"),
        ({"steps": 10**7}, "steps 10000000: use"),
        ({"scale": -1.0}, r"scale -1\.0: use 0\.001 to 10,000"),
        ({"scale": float("inf")}, "with scale inf"),
        ({"lr": float("nan")}, "lr nan"),
        ({"object_size": 10**400}, r"object_size 10+\.\.\.: use 1 to 10,000"),
        ({"intensity": 1.6}, r"intensity 1\.6: use 0 to 1\.5"),
        ({"form": -0.1}, r"form -0\.1: use 0 to 1\.5"),
        ({"content": -0.1}, r"content -0\.1: use 0 to"),
        ({"rotate": float("nan")}, "with rotate nan"),
        ({"seed": -(10**400)}, r"seed -10+\.\.\.: use"),
        ({"block": 5}, "block 5: use 1 to 4"),
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
    "block": 3,  # ARF (Zhang et al. 2022), section 4: conv3, which the official code keeps
    "object_size": None,
    "rotate": 0.0,
    "region": None,
}


def test_the_papers_preset_is_the_method_as_published():
    paper = STYLE_PRESETS["paper"]
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
