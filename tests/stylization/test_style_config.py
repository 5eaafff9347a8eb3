from typing import Any

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.style_config import PRESETS, StyleConfig


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"steps": 0}, "steps 0: it must exceed 0"),
        ({"scale": -1.0}, r"scale -1\.0: it must exceed 0"),
        ({"lr": float("nan")}, "lr nan"),
        ({"object_size": 0}, "object_size 0"),
        ({"intensity": 1.6}, r"intensity 1\.6: use 0 to 1\.5"),
        ({"view_share": 0.0}, r"share of 0\.0 of the views"),
        ({"layers": ()}, "name some of 1 to 4"),
        ({"layers": (3, 5)}, "name some of 1 to 4"),
        ({"scale": float("inf")}, "with scale inf: use 10000 at most"),
        ({"rotate": float("nan")}, "with rotate nan"),
        ({"content": -0.1}, r"content -0\.1: use 0 or more"),
        ({"smoothness": float("nan")}, "smoothness nan"),
        ({"object_size": 10**400}, "object_size 10+: use 10000 at most"),
        ({"steps": 10**7}, "steps 10000000 and seed 0: use 1e.06"),
        ({"seed": -(10**400)}, "seed -10+: use .* 1e.18 at most"),
        ({"max_growth": 0.5}, r"grow to 0\.5 times"),
        ({"texture": 1.5}, r"texture 1\.5: use keep, soften, replace or 0 to 1"),
        ({"texture": float("nan")}, "texture nan"),
    ],
)
def test_settings_out_of_range(settings: dict[str, Any], message: str):
    with pytest.raises(StyleSplatError, match=message):
        StyleConfig(**settings)


def test_the_papers_preset():
    paper = PRESETS["paper"]
    assert (paper.steps, paper.view_share, paper.lr) == (500, 0.25, 0.0025)
    assert (paper.view_dependence, paper.color, paper.max_growth) == ("train", "free", 1)
    assert paper.stages(321.0) == [(321.0, 500)], "as large as in the photos"


def test_textures_by_name_and_share():
    textures = ("keep", 0.25, "soften", 0.75, "replace")
    softened = [StyleConfig(texture=texture).softened for texture in textures]
    assert softened == [0, 0.25, 0.5, 0.75, 1]


@pytest.mark.parametrize("steps", [1, 2, 3, 300])
def test_stages_use_up_the_steps_and_end_at_full_size(steps: int):
    stages = StyleConfig(steps=steps, object_size=100).stages(500.0)
    assert sum(count for _, count in stages) == steps
    assert all(count > 0 for _, count in stages)
    lengths = [length for length, _ in stages]
    assert lengths == sorted(lengths)
    assert steps < 4 or lengths[-1] == 100
