from typing import Any

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.config import PRESETS, StyleConfig


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"steps": 0}, "steps 0: it must exceed 0"),
        ({"scale": -1.0}, r"scale -1\.0: it must exceed 0"),
        ({"lr": float("nan")}, "lr nan"),
        ({"object_size": 0}, "object_size 0"),
        ({"intensity": 1.6}, r"intensity 1\.6: use 0 to 1\.5"),
        ({"view_share": 0.0}, r"share of 0\.0 of the views"),
        ({"blocks": ()}, "name at least one block"),
    ],
)
def test_settings_out_of_range(settings: dict[str, Any], message: str):
    with pytest.raises(StyleSplatError, match=message):
        StyleConfig(**settings)


def test_the_papers_preset():
    paper = PRESETS["paper"]
    assert (paper.steps, paper.view_share, paper.lr) == (500, 0.25, 0.0025)
    assert paper.view_dependent and not paper.color_transfer
