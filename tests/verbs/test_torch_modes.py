"""Verbs compute the same whatever modes of torch their callers have set."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, PAINTED_FAST, assert_same_splats, own_rows
from balls import TRAINED as BALLS
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.stylization.style import Style
from stylesplat.verbs.render import render
from stylesplat.verbs.stylize import stylize, stylize_live
from stylesplat.verbs.train import train

pytestmark = pytest.mark.usefixtures("quick_painting")

TRAINED = replace(BALLS, cameras=CAMERAS[::2])


@contextmanager
def float64() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


MODES = pytest.mark.parametrize("mode", [torch.inference_mode, torch.no_grad, float64])


def style() -> Style:
    generator = torch.Generator().manual_seed(0)
    colors = torch.rand(40, 40, 3, generator=generator, dtype=torch.float32)
    return Style(colors, config=PAINTED_FAST)


@pytest.fixture(scope="module")
def wanted() -> Scene:
    return stylize(TRAINED, {"red": style()}, device="cpu", measured=False)


@MODES
def test_painting(mode: type[AbstractContextManager[None]], wanted: Scene):
    with mode():
        splats = TRAINED.splats.map(torch.clone)
        scene = Scene(splats, TRAINED.cameras, TRAINED.held_out, objects=TRAINED.objects)
        whole = stylize(scene, {"red": style()}, device="cpu", measured=False)
        *_, last = stylize_live(scene, "red", style(), device="cpu")
        dtypes = {name: t.dtype for name, t in last.splats.tensors().items()}
        assert torch.is_inference_mode_enabled() == (mode is torch.inference_mode)
    assert own_rows(whole, "red").any() and {*dtypes.values()} == {torch.float32}
    assert_same_splats(whole.splats, wanted.splats)
    assert_same_splats(last.splats, wanted.splats)


@MODES
def test_training_and_rendering(mode: type[AbstractContextManager[None]]):
    with mode():
        photos = [picture for _, picture in render(TRAINED, device="cpu")]
        capture = Capture(TRAINED.cameras, [photo.clone() for photo in photos])
        scene = train(capture, steps=2, max_gaussians=500, device="cpu")
    assert scene.splats.means.dtype == torch.float32 and scene.metrics["steps"] == 2
