"""What is said of a stylisation is true."""

import pytest

from stylesplat.evaluation.summary import (
    WHOLE,
    describe_changes,
    painted_gaussians,
    photo_lines,
    style_lines,
)

QUIET = {"changed_outside": 0, "outside_max_difference": 0.0, "stain_pixels": 0}
VASE = {
    "nnfm_after": {"vase": 0.12},
    "nnfm_of_style": {"vase": 0.1},
    "share_of_way": {"vase": 0.714},
}


def test_one_object_in_one_line():
    expected = "vase: 71 % of the way to the painting, nothing else changed."
    assert style_lines(QUIET | VASE, ["vase"]) == [expected]


def test_several_objects_have_a_line_each():
    lines = style_lines(QUIET | VASE, ["vase", "pot"])
    assert lines == [
        "vase: 71 % of the way to the painting.",
        "pot: painted.",
        "Nothing else changed.",
    ]


@pytest.mark.parametrize(
    ("after", "share", "expected"),
    [(0.1, 1.0, WHOLE), (0.08, 1.0, WHOLE), (0.1001, 0.999, "99 % of"), (0.3, 0.0, "0 % of")],
)
def test_the_end_of_the_way(after: float, share: float, expected: str):
    numbers = {
        "nnfm_after": {"a": after},
        "nnfm_of_style": {"a": 0.1},
        "share_of_way": {"a": share},
    }
    assert expected in style_lines(QUIET | numbers, ["a"])[0]


def test_what_was_close_before_has_no_way():
    near = QUIET | {"nnfm_of_style": {"a": 0.1}}
    assert WHOLE in style_lines(near | {"nnfm_after": {"a": 0.05}}, ["a"])[0]
    assert "a: painted" in style_lines(near | {"nnfm_after": {"a": 0.2}}, ["a"])[0]


@pytest.mark.parametrize(("share", "words"), [(0.123, "12 % of it in colours"), (0.05, None)])
def test_colours_that_the_painting_does_not_have_are_named_if_they_are_many(
    share: float, words: str | None
):
    (line,) = style_lines(QUIET | VASE | {"off_palette": {"vase": share}}, ["vase"])
    assert (words or "71 %") in line and ("colours" in line) == (words is not None)


def test_what_changed_around_is_said():
    assert describe_changes(QUIET) == "nothing else changed"
    unlooked = {name: value for name, value in QUIET.items() if name != "stain_pixels"}
    assert describe_changes(unlooked) == "no other Gaussian changed", (
        "of pixels beside nothing is known"
    )
    stained = QUIET | {"stain_pixels": 1200, "stain_view": "a.jpg"}
    assert describe_changes(stained) == "a stain of 1,200 pixels beside the object in view a.jpg"
    assert "by 3 of 255 levels" in describe_changes(QUIET | {"outside_max_difference": 3 / 255})
    assert describe_changes(QUIET | {"changed_outside": 1200}).startswith("1,200 Gaussians outside")


def test_how_many_gaussians_were_painted():
    counts = {"painted_gaussians": 20_000, "changed_gaussians": 87_936, "changed_outside": 0}
    assert painted_gaussians(counts, 60_000) == "20,000 of 60,000, and a canvas of 67,936"
    counts["changed_gaussians"] = 20_000
    assert painted_gaussians(counts, 60_000) == "20,000 of 60,000"


def test_photos_and_label_maps():
    assert photo_lines({}) == []
    photos, objects = photo_lines(
        {"psnr": 30.554, "ssim": 0.9, "miou": 0.956, "boundary_miou": 0.8}
    )
    assert "30.55 dB" in photos and "0.96" in objects and "0.80" in objects
