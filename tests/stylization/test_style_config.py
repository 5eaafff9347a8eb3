from dataclasses import replace
from typing import Any

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.stages import FINEST, LEAST, PLANS, WINDOW, Quality, Stage
from stylesplat.stylization.style import Style
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


PUBLISHED = {
    "steps": 500,  # section 4, implementation details: 500 to 1,000 iterations
    "view_share": 0.25,  # section 4, implementation details: 25 % of the training images
    "view_dependence": "train",  # section 3.4: gradients for the SH coefficients, all of them
    "max_growth": 1.0,  # section 3.4: all other properties of the Gaussians are frozen
    "hard": True,  # section 3.4: the Gaussians above the threshold, each alike
    "color": "free",  # section 3.4: the NNFM loss alone, no transfer of colours
    "texture": "keep",  # section 3.4: fine-tuned from the coefficients as trained
    "content": 0.0,  # section 3.4: no other loss
    "smoothness": 0.0,
    "intensity": 1.0,  # section 4, scale control: intensity is the learning rate
    "lr": 0.0025,  # the official code, which keeps 3D Gaussian splatting's feature_lr
    "final_lr": 1.0,  # and its schedule of colours: none
    "layers": (3,),  # ARF (Zhang et al. 2022), section 4: conv3, which the official code keeps
    "pattern": "photo",  # section 3.4: the loss between the rendered training view and the style
    "object_size": None,
    "rotate": 0.0,
    "region": None,
}


@pytest.mark.parametrize(("name", "value"), PUBLISHED.items())
def test_the_papers_preset_is_the_method_as_published(name: str, value: Any):
    assert getattr(PRESETS["paper"], name) == value


def test_the_papers_views_are_seen_whole_in_one_stage_with_vgg16():
    stages = PRESETS["paper"].stages(321.0)
    assert stages == [Stage((321.0,), 500)], "as large as in the photos"
    style = Style("wave.jpg", preset="paper")  # section 3.4: VGG features; VGG16 in the code
    assert (style.config, style.network) == (PRESETS["paper"], "vgg16")
    assert Style("wave.jpg").network == "compact"


def test_textures_by_name_and_share():
    textures = ("keep", 0.25, "soften", 0.75, "replace")
    softened = [StyleConfig(texture=texture).softened for texture in textures]
    assert softened == [0, 0.25, 0.5, 0.75, 1]


@pytest.mark.parametrize("quality", ["draft", "normal", "high"])
@pytest.mark.parametrize("steps", [1, 2, 3, 300, None])
def test_stages_use_up_the_steps_and_grow(quality: Quality, steps: int | None):
    config = StyleConfig(quality=quality, steps=steps)
    stages = config.stages(500.0)
    assert sum(stage.steps for stage in stages) == config.all_steps == (steps or config.all_steps)
    assert all(stage.steps > 0 for stage in stages)
    lengths = [length for stage in stages for length in stage.lengths]
    assert lengths == sorted(lengths)


def test_qualities_end_at_their_sizes():
    configs = [StyleConfig(quality=quality) for quality in PLANS]
    ends = [config.stages(500.0)[-1].lengths for config in configs]
    assert ends == [(160.0,), (250.0, 500.0), (250.0, 500.0)]
    steps = [config.all_steps for config in configs]
    assert steps == sorted(steps)


def test_drafts_split_nothing_unless_asked():
    growths = [StyleConfig(quality=quality).growth(20_000) for quality in PLANS]
    assert growths == [1, 4, 4]
    assert StyleConfig(quality="draft", max_growth=2.0).growth(20_000) == 2
    few = [StyleConfig().growth(gaussians) for gaussians in (10_000, 5_000, 1_000, 0)]
    assert few == [4, 6, 16, 16], "small and smooth objects grow more"


@pytest.mark.parametrize(
    ("photo_length", "lengths"),
    [(100.0, (160.0, 160.0)), (200.0, (160.0, 200.0)), (4000.0, (FINEST / 2, FINEST))],
)
def test_fine_stages_follow_the_photos_within_bounds(
    photo_length: float, lengths: tuple[float, ...]
):
    assert StyleConfig(quality="high").stages(photo_length)[-1].lengths == lengths


def test_an_object_size_is_the_largest():
    stages = StyleConfig(object_size=100).stages(500.0)
    assert max(length for stage in stages for length in stage.lengths) == 100


def test_sizes_follow_the_scale():
    """Beside a style image of the same size: an object half as long shows strokes twice as large.
    Fine stages too, else they would add small strokes; sizes stay within the photos'."""
    usual, large, small = (
        StyleConfig(scale=scale, canvas="own").stages(500.0) for scale in (2.0, 4.0, 1.0)
    )
    assert [stage.lengths for stage in usual] == [(96.0,), (160.0,), (250.0, 500.0)]
    assert [stage.lengths for stage in large] == [(48.0,), (80.0,), (125.0, 250.0)]
    assert [stage.lengths for stage in small] == [(192.0,), (320.0,), (320.0, 500.0)]
    assert [stage.window for stage in usual] == [None, None, WINDOW]
    assert [stage.window for stage in small] == [WINDOW] * 3, "no step costs more than usual"
    assert [stage.anchored for stage in small] == [False, False, True]


def test_what_waits_for_a_canvas_shows_strokes_before():
    first, then, *rest = StyleConfig().stages(500.0)
    whole, *others = StyleConfig(canvas="own").stages(500.0)
    assert first.steps < then.steps
    assert replace(then, steps=first.steps + then.steps) == whole
    assert rest == others
    for plain in (StyleConfig(quality="draft"), StyleConfig(max_growth=1.0)):
        assert plain.stages(500.0) == replace(plain, canvas="own").stages(500.0)


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_sizes_stay_within_bounds_at_any_scale(scale: float):
    config = StyleConfig(scale=scale)
    lengths = [length for stage in config.stages(500.0) for length in stage.lengths]
    assert lengths == sorted(lengths)
    assert min(lengths) >= LEAST and max(lengths) <= 500
    assert config.finest(500.0) == 500, "large strokes have edges as sharp as others"
    tiny = StyleConfig(scale=scale, object_size=20).stages(500.0)
    assert max(length for stage in tiny for length in stage.lengths) == 20


def test_only_strokes_larger_than_usual_level_what_is_finer():
    shares = [StyleConfig(scale=scale).levelled for scale in (0.5, 2.0, 4.0, 8.0)]
    assert shares == [0, 0, 0.5, 0.75]
    assert StyleConfig(scale=4.0, pattern="photo").levelled == 0, "as published"
