from dataclasses import replace
from pathlib import Path

import pytest
import torch

from ball_photos import write_ball_capture
from balls import CAMERAS, enlarged
from painted_balls import TRAINED, painted, write_pictures
from stylesplat.figures.side_by_side import (
    GAP,
    NARROWEST,
    before_after,
    beside_photo,
    one_view,
    side_by_side,
)
from stylesplat.scene.scene import Scene
from stylesplat.verbs.load import load


@pytest.fixture(scope="module")
def styled(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    scene = replace(TRAINED, cameras=enlarged(CAMERAS, 2))
    pictures = write_pictures(tmp_path_factory.mktemp("pictures"))
    return painted(scene, "red", pictures, intensity=1.0, layers=(2,))


def test_before_and_after_at_the_photos_size(styled: Scene):
    found = before_after(styled, device="cpu")
    assert found is not None and found[0] in styled.cameras.names
    picture = found[1]
    assert picture.shape == (72, 2 * 96 + GAP, 3)
    before, after = picture[:, :96].float(), picture[:, 96 + GAP :].float()
    assert bool((picture[:, 96 : 96 + GAP] == 255).all())
    changed = (before - after).abs().amax(dim=-1) > 0
    assert 20 < int(changed.sum()) < 0.3 * changed.numel(), "the ball, and nothing else"
    assert before[changed][:, 0].mean() > 100 > before[changed][:, 2].mean(), "it was red before"


def test_what_no_view_shows_has_no_picture(styled: Scene):
    away = replace(styled.cameras, viewmats=styled.cameras.viewmats + 0)
    away.viewmats[:, 2, 3] -= 100
    assert before_after(replace(styled, cameras=away), device="cpu") is None


def test_a_photo_beside_its_render(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """At the photo's own size, though the scene was made from a smaller one, and captioned."""
    texts = list[str]()

    def write_line(sheet: object, place: object, text: str, *_: object) -> None:
        texts.append(text)

    monkeypatch.setattr("stylesplat.figures.side_by_side.write_line", write_line)
    views = enlarged(CAMERAS[[2, 5]], 12)
    capture = load(write_ball_capture(tmp_path / "balls", views, masks=False), downscale=6.0)
    scene = replace(TRAINED, cameras=views, held_out=CAMERAS.names[2:3])
    picture = beside_photo(scene, capture, CAMERAS.names[2], device="cpu")
    wide, high = 12 * 48, 12 * 36
    assert picture.shape == (high + 22 + GAP, 2 * wide + GAP, 3)
    photo, render = picture[:high, :wide].float(), picture[:high, wide + GAP :].float()
    assert (photo - render).abs().mean() < 12, "they show the same"
    other = one_view(scene, CAMERAS.names[5], device="cpu").float()
    assert (photo - other).abs().mean() > 20
    assert texts[0] == f"held-out photo {CAMERAS.names[2]}"
    assert 15 < float(texts[1].removeprefix("render, PSNR ").removesuffix(" dB")) < 60


def test_small_photos_are_enlarged_and_their_captions_drawn(tmp_path: Path):
    capture = load(write_ball_capture(tmp_path / "balls"), downscale=2.0)
    picture = beside_photo(TRAINED, capture, CAMERAS.names[2], device="cpu")
    high = round(36 * NARROWEST / 48)
    assert picture.shape[0] > high and picture.shape[1] == 2 * NARROWEST + GAP
    below = picture[high:]
    for part in (below[:, :NARROWEST], below[:, -NARROWEST:]):
        assert part.min() < 60 and part[:, -100:].min() == 255, "dark text at the left, on white"


def test_pictures_of_different_heights():
    tall, low = torch.zeros(4, 2, 3, dtype=torch.uint8), torch.zeros(2, 3, 3, dtype=torch.uint8)
    sheet = side_by_side([tall, low])
    assert sheet.shape == (4, 5 + GAP, 3) and bool((sheet[2:, 2 + GAP :] == 255).all())
