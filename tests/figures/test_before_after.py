from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, TRAINED, enlarged, painted, write_pictures
from capture_files import write_ball_capture
from stylesplat.figures.grid import CAPTION, MARGIN, PAPER
from stylesplat.figures.sheets import NARROWEST, before_after, beside_photo, one_view
from stylesplat.scene.scene import Scene
from stylesplat.verbs.load import load


@pytest.fixture(scope="module")
def styled(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    scene = replace(TRAINED, cameras=enlarged(CAMERAS, 2))
    pictures = write_pictures(tmp_path_factory.mktemp("pictures"))
    return painted(scene, "red", pictures, intensity=1.0, layers=(2,))


def pair(picture: torch.Tensor, width: int, height: int) -> list[torch.Tensor]:
    """The two pictures of a row."""
    lefts = (MARGIN, 2 * MARGIN + width)
    return [picture[MARGIN : MARGIN + height, each : each + width].float() for each in lefts]


def test_before_and_after_at_the_photos_size(styled: Scene):
    found = before_after(styled, device="cpu")
    assert found is not None and found[0] in styled.cameras.names
    picture = found[1]
    assert picture.shape == (72 + CAPTION + 2 * MARGIN, 2 * 96 + 3 * MARGIN, 3)
    before, after = pair(picture, 96, 72)
    changed = (before - after).abs().amax(dim=-1) > 0
    assert 20 < int(changed.sum()) < 0.3 * changed.numel(), "the ball, and nothing else"
    assert before[changed][:, 0].mean() > 100 > before[changed][:, 2].mean(), "it was red before"


def test_what_no_view_shows_has_no_picture(styled: Scene):
    away = replace(styled.cameras, viewmats=styled.cameras.viewmats + 0)
    away.viewmats[:, 2, 3] -= 100
    assert before_after(replace(styled, cameras=away), device="cpu") is None


def test_a_photo_beside_its_render(tmp_path: Path):
    """At the photo's own size, though the scene was made from a smaller one, and captioned."""
    views = enlarged(CAMERAS[[2, 5]], 12)
    capture = load(write_ball_capture(tmp_path / "balls", views, masks=False), downscale=6.0)
    scene = replace(TRAINED, cameras=views, held_out=CAMERAS.names[2:3])
    picture = beside_photo(scene, capture, CAMERAS.names[2], device="cpu")
    wide, high = 12 * 48, 12 * 36
    assert picture.shape == (high + CAPTION + 2 * MARGIN, 2 * wide + 3 * MARGIN, 3)
    photo, render = pair(picture, wide, high)
    assert (photo - render).abs().mean() < 12, "they show the same"
    other = one_view(scene, CAMERAS.names[5], device="cpu").float()
    assert (photo - other).abs().mean() > 20
    trained = beside_photo(replace(scene, held_out=()), capture, CAMERAS.names[2], device="cpu")
    changed = (trained != picture).any(dim=-1).nonzero()
    assert changed[:, 0].min() >= MARGIN + high and changed[:, 1].max() < MARGIN + wide


def test_small_photos_are_enlarged_and_their_captions_drawn(tmp_path: Path):
    capture = load(write_ball_capture(tmp_path / "balls"), downscale=2.0)
    picture = beside_photo(TRAINED, capture, CAMERAS.names[2], device="cpu")
    high = round(36 * NARROWEST / 48)
    assert picture.shape[0] > high and picture.shape[1] == 2 * NARROWEST + 3 * MARGIN
    below = picture[MARGIN + high :]
    for left in (MARGIN, 2 * MARGIN + NARROWEST):
        part = below[:, left : left + NARROWEST]
        assert part.min() < 60 and bool((part[:, -100:] == torch.tensor(PAPER)).all())
