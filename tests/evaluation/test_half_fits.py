import torch

from balls import CAMERAS, SPLATS
from stylesplat.evaluation.half_fits import Fits, fits_of, fitted_render
from stylesplat.evaluation.photo_metrics import evaluate_views
from stylesplat.metrics.psnr import psnr
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.training.per_photo import shift_cameras

COLORS, POSE = Fits(colors=True), Fits(pose=True, unit=3.0)
CAMERA = CAMERAS[2]


def render() -> torch.Tensor:
    return rasterize(SPLATS, CAMERA)[0][0]


def test_another_exposure_is_seen_through():
    photo = 0.7 * render() * torch.tensor([1.05, 1.0, 0.9])
    assert psnr(render(), photo) < 25
    assert (
        psnr(fitted_render(SPLATS, CAMERA, photo, COLORS), photo) > 34
    )  # the prior keeps a little


def test_no_half_sees_itself():
    photo = 0.7 * render()
    before = fitted_render(SPLATS, CAMERA, photo, COLORS)
    middle = CAMERA.size[0] // 2
    photo[:, :middle] = torch.rand(photo[:, :middle].shape, generator=torch.Generator())
    after = fitted_render(SPLATS, CAMERA, photo, COLORS)
    assert torch.equal(after[:, :middle], before[:, :middle])
    assert not torch.equal(after[:, middle:], before[:, middle:])


def test_a_shaken_camera_is_found():
    shift = torch.tensor([[0.01, -0.01, 0.01, 0.01, 0.005, -0.005]])
    photo = rasterize(SPLATS, shift_cameras(CAMERA, shift, POSE.unit))[0][0]
    fitted = fitted_render(SPLATS, CAMERA, photo, POSE)
    assert psnr(fitted, photo) > psnr(render(), photo) + 6


def test_scores_say_what_is_without_the_fit():
    photos = [(0.7 * render().clamp(0, 1) * 255).round().to(torch.uint8)]
    capture = Capture(CAMERA, photos)
    plain = evaluate_views(SPLATS, capture, [0])
    both = evaluate_views(SPLATS, capture, [0], fits=COLORS)
    assert both["psnr_unfitted"] == plain["psnr"] and both["ssim_unfitted"] == plain["ssim"]
    assert both["psnr"] > plain["psnr"] + 10
    assert "psnr_unfitted" not in plain


def test_names_say_what_is_fitted():
    for fits in (Fits(), COLORS, Fits(colors=True, pose=True)):
        again = fits_of(fits.names, CAMERAS)
        assert (again.colors, again.pose) == (fits.colors, fits.pose)
