"""Renders against photos, and what a photo has of its own."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.photos import Fits, evaluate_views, fitted_render
from stylesplat.imaging.similarity import psnr
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.selection.labels import render_labels
from stylesplat.training.per_photo import shift_cameras


@pytest.fixture
def capture() -> Capture:
    """Photos and label maps that the balls match up to rounding."""
    images, _, _ = rasterize(SPLATS, CAMERAS)
    return Capture(
        cameras=CAMERAS,
        photos=[(i.clamp(0, 1) * 255).round().to(torch.uint8) for i in images],
        label_maps=[render_labels(SPLATS, CAMERAS[row]) for row in range(8)],
    )


def test_perfect_splats_score_as_well_as_8_bit_photos_allow(capture):
    plain = evaluate_views(SPLATS, replace(capture, label_maps=None), [0])
    assert plain.keys() == {"psnr", "ssim"}, "no mIoU without label maps"
    metrics = evaluate_views(SPLATS, capture, [0, 5])
    assert metrics["psnr"] > 55  # rounding to 1/255 alone gives 59 dB
    assert metrics["ssim"] > 0.999
    assert metrics["miou"] == metrics["boundary_miou"] == 1
    assert metrics["iou"] == {3: 1, 7: 1, 300: 1}


def test_ids_that_nobody_learned_are_left_out_and_known_ones_count(capture):
    maps = [labels.clone() for labels in capture.label_maps]
    maps[0][:, :10] = 99  # over table, background and a part of a ball, maybe
    metrics = evaluate_views(SPLATS, replace(capture, label_maps=maps), [0, 1])
    assert metrics["unknown_ids"] == [99]
    assert metrics["iou"] == {3: 1, 7: 1, 300: 1} and metrics["miou"] == 1
    maps[0] = capture.label_maps[0].clone()
    maps[0][maps[0] == 0] = 3
    metrics = evaluate_views(SPLATS, replace(capture, label_maps=maps), [0])
    assert metrics["iou"][3] < 0.5 and metrics["iou"][7] == 1 and "unknown_ids" not in metrics


def test_transparent_photos_are_compared_over_black(capture):
    _, coverage, _ = rasterize(SPLATS, CAMERAS)
    alphas = [(255 * a[..., 0]).round().to(torch.uint8) for a in coverage]
    cut_out = replace(capture, alphas=alphas)
    found, whole = (evaluate_views(SPLATS, each, [0]) for each in (cut_out, capture))
    assert found.pop("object_psnr") < found["psnr"], "what is transparent is right everywhere"
    assert found == whole
    first = torch.tensor([0])
    everywhere = replace(
        SPLATS,
        means=SPLATS.means.index_fill(0, first, 0.0),
        scales=SPLATS.scales.index_fill(0, first, 3.0),
    )
    assert evaluate_views(everywhere, cut_out, [0])["psnr"] < 30


def test_no_views(capture):
    with pytest.raises(StyleSplatError, match=r"no held-out views.*--test-every"):
        evaluate_views(SPLATS, capture, [])


COLORS, POSE = Fits(colors=True), Fits(pose=True, unit=3.0)
CAMERA = CAMERAS[2]


def render() -> torch.Tensor:
    return rasterize(SPLATS, CAMERA)[0][0]


def test_another_exposure_is_seen_through_and_no_half_sees_itself():
    photo = 0.7 * render() * torch.tensor([1.05, 1.0, 0.9])
    assert psnr(render(), photo) < 25
    before = fitted_render(SPLATS, CAMERA, photo, COLORS)[0]
    assert psnr(before, photo) > 34  # the prior keeps a little
    middle = CAMERA.size[0] // 2
    photo[:, :middle] = torch.rand(photo[:, :middle].shape, generator=torch.Generator())
    after = fitted_render(SPLATS, CAMERA, photo, COLORS)[0]
    assert torch.equal(after[:, :middle], before[:, :middle])
    assert not torch.equal(after[:, middle:], before[:, middle:])


def test_a_shaken_camera_is_found():
    shift = torch.tensor([[0.01, -0.01, 0.01, 0.01, 0.005, -0.005]])
    photo = rasterize(SPLATS, shift_cameras(CAMERA, shift, POSE.unit))[0][0]
    fitted = fitted_render(SPLATS, CAMERA, photo, POSE)[0]
    assert psnr(fitted, photo) > psnr(render(), photo) + 6


def test_scores_say_what_is_without_the_fit():
    photos = [(0.7 * render().clamp(0, 1) * 255).round().to(torch.uint8)]
    capture = Capture(CAMERA, photos)
    plain = evaluate_views(SPLATS, capture, [0])
    both = evaluate_views(SPLATS, capture, [0], fits=COLORS)
    assert both["psnr_unfitted"] == plain["psnr"] and both["ssim_unfitted"] == plain["ssim"]
    assert both["psnr"] > plain["psnr"] + 10
    assert "psnr_unfitted" not in plain


@pytest.mark.parametrize("fits", [Fits(), COLORS])
def test_pixels_that_are_masked_out_are_not_compared(capture, fits: Fits):
    valid = torch.ones(CAMERA.size[::-1], dtype=torch.bool)
    valid[10:30, 5:40] = False
    magenta = torch.tensor([255, 0, 255], dtype=torch.uint8)
    painted = [photo.where(valid[..., None], magenta) for photo in capture.photos]
    maps = [labels.where(valid, 3) for labels in capture.label_maps]
    masked = replace(capture, photos=painted, label_maps=maps, valid_masks=[valid] * 8)
    metrics = evaluate_views(SPLATS, masked, [0], fits=fits)
    assert metrics["psnr"] > 40 and metrics["ssim"] > 0.99 and metrics["miou"] == 1


def test_masks_that_leave_nothing(capture, said: list[str]):
    nothing = torch.zeros(CAMERA.size[::-1], dtype=torch.bool)
    masked = replace(capture, label_maps=None, valid_masks=[nothing, *[None] * 7])
    assert evaluate_views(SPLATS, masked, [0]) == {}
    assert "no pixel" in said[0]
    assert evaluate_views(SPLATS, masked, [0, 1]) == evaluate_views(SPLATS, masked, [1])


def test_transparent_photos_are_compared_over_white(capture):
    _, coverage, _ = rasterize(SPLATS, CAMERAS)
    alphas = [(255 * a[..., 0]).round().to(torch.uint8) for a in coverage]
    cut_out = replace(capture, alphas=alphas)
    black = replace(cut_out, photos=[torch.zeros_like(photo) for photo in capture.photos])
    scores = [
        evaluate_views(SPLATS, each, [0], background=background)["psnr"]
        for each in (cut_out, black)
        for background in ("black", "white")
    ]
    assert min(scores[:2]) > 45
    assert scores[2] == pytest.approx(scores[3], abs=0.5)  # the colours differ as before
