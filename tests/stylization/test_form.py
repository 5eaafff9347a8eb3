"""What counts as form: luminance detail that stands out; a pattern all over does not."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from balls import CAMERAS, COUNT, LIGHT, PICKED, WAYS, cropped, dense_ball, enlarged
from scenes import rand
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import coverage
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.form import (
    FormSurvey,
    FormTarget,
    PooledMask,
    detail_bands,
    form_distance,
    form_relief,
    measure_detail,
    measure_form,
)
from stylesplat.stylization.painter import paint
from stylesplat.stylization.views import find_boxes, typical_length

LENGTH = 120.0  # longer side of the object, in pixels
SIDE = 140
YS, XS = (
    axis + 0.5 - SIDE / 2 for axis in torch.meshgrid(*[torch.arange(SIDE)] * 2, indexing="ij")
)
MASK = (XS.square() + YS.square()).sqrt() < LENGTH / 2
EYE = (14.0, -12.0)  # centre of a spot
RADIUS = 4.0


def grey(luminance: Tensor) -> Tensor:
    return luminance[..., None].expand(SIDE, SIDE, 3).contiguous()


def spot(x: float, y: float, radius: float = RADIUS) -> Tensor:
    """1 inside a spot with a soft border, 0 elsewhere."""
    return (radius - ((XS - x).square() + (YS - y).square()).sqrt() + 0.5).clamp(0, 1)


PLAIN = 0.5 + 0.2 * YS / SIDE  # a ball in soft light
WITH_EYE = grey(PLAIN - 0.3 * spot(*EYE))
DOTS = sum(spot(12.0 * i, 12.0 * j, 3.0) for i in range(-6, 7) for j in range(-6, 7))
DOTTED = grey(PLAIN - 0.3 * torch.as_tensor(DOTS))
LUMA = torch.tensor([0.2126, 0.7152, 0.0722])  # Rec. 709
SOME = rand(SIDE, SIDE, 3)
NEAR_EYE = spot(*EYE, RADIUS + 2) > 0
FAR = MASK & (spot(*EYE, 5 * RADIUS) == 0) & (XS.square() + YS.square() < (0.4 * LENGTH) ** 2)


def form_of(image: Tensor) -> FormTarget:
    return measure_form(image, MASK, LENGTH, measure_detail([image], [MASK], LENGTH))


def shares(form: FormTarget) -> list[float]:
    return form.weight.sum(dim=(1, 2)).tolist()


def distance(image: Tensor, form: FormTarget) -> float:
    return float(form_distance(image, LENGTH, form))


def test_an_eye_stands_out_of_a_plain_ball():
    form = form_of(WITH_EYE)
    for detail, weight in zip(form.detail, form.weight, strict=True):
        assert detail[NEAR_EYE].abs().max() > 10 * detail[FAR].abs().max()
        assert weight[NEAR_EYE].mean() > 1.5 * weight[FAR].mean()


def test_what_differs_in_hue_alone_stands_out_too():
    """Beside the eye, which is darker, a spot of the same luminance in another hue."""
    hue = torch.tensor([0.5, 0.0, -0.5])
    hue = hue - (hue @ LUMA) / LUMA.sum()
    spotted = WITH_EYE + spot(-EYE[0], EYE[1])[..., None] * hue
    assert torch.allclose(spotted @ LUMA, WITH_EYE @ LUMA, atol=1e-5)
    here = NEAR_EYE.flip(1)
    grey_form, form = form_of(WITH_EYE), form_of(spotted)
    for before, after in zip(grey_form.detail, form.detail, strict=True):
        assert after[here].abs().max() > 3 * before[here].abs().max()


def test_dots_all_over_do_not_stand_out():
    """But for the outline, where there are fewer of them around. Nothing does on a flat object."""
    dots, eye = form_of(DOTTED), form_of(WITH_EYE)
    assert max(shares(dots)) < 0.3 * max(shares(eye))
    flat = form_of(grey(torch.full((SIDE, SIDE), 0.5)))
    assert max(shares(flat)) < 1e-3
    assert distance(SOME, flat) < 1e-2, "so that it asks for nothing"
    inside = XS.square() + YS.square() < (0.35 * LENGTH) ** 2
    bands = detail_bands(DOTTED @ LUMA, MASK, LENGTH)
    for detail, band in zip(dots.detail, bands, strict=True):
        assert detail[inside].square().sum() < 0.1 * band[inside].square().sum()


def test_letters_stand_out_though_they_are_many():
    """Rows of strokes of all lengths stand out; a patchwork of many greys does not."""
    strokes = (rand(28, 28) < 0.4).float()
    for blank in (slice(6), slice(None, None, 4), slice(-6, None)):
        strokes[blank] = 0
    letters, patches = (
        form_of(grey(PLAIN - 0.3 * each.repeat_interleave(5, 0).repeat_interleave(5, 1)))
        for each in (strokes, rand(28, 28))
    )
    assert min(shares(letters)) > 4 * max(shares(patches))


def test_the_unpainted_view_is_nearest_to_itself():
    form = form_of(WITH_EYE)
    least = distance(WITH_EYE, form)
    moved = grey(PLAIN - 0.3 * spot(-EYE[0], EYE[1]))
    inverted = grey(PLAIN + 0.3 * spot(*EYE))
    for other in (grey(PLAIN), moved, inverted, SOME, DOTTED):
        assert distance(other, form) > least + 0.3
    assert distance(inverted, form) > distance(grey(PLAIN), form), "white for black is worse"
    mixtures = [WITH_EYE.lerp(SOME, share) for share in (0.0, 0.1, 0.3, 0.6, 1.0)]
    distances = [distance(mixture, form) for mixture in mixtures]
    assert distances == sorted(distances)


def test_brightness_contrast_and_hue_do_not_matter():
    form = form_of(WITH_EYE)
    hue = torch.tensor([0.3, 0.0, 0.0]) - 0.3 * LUMA[0] / LUMA.square().sum() * LUMA
    for image in (WITH_EYE, SOME):
        others = [factor * image + offset for factor, offset in ((1.0, 0.3), (0.4, 0.6))]
        for other in (*others, image + 0.5 * SOME[..., :1] * hue):
            assert distance(other, form) == pytest.approx(distance(image, form), abs=0.05)


def test_what_lies_outside_does_not_matter():
    def beside(image: Tensor) -> Tensor:
        return torch.where(MASK[..., None], image, SOME)

    form, other = form_of(WITH_EYE), form_of(beside(WITH_EYE))
    assert torch.equal(form.detail, other.detail)
    image = beside(SOME.flip(0)).requires_grad_()
    form_distance(image, LENGTH, form).backward()
    assert image.grad is not None
    assert not image.grad[~MASK].any() and image.grad[MASK].any()


def test_sizes_follow_the_object():
    """Twice as large in twice as many pixels, it has the same form."""
    soft = grey(PLAIN - 0.3 * (-((XS - 14).square() + (YS + 12).square()) / 50).exp())
    double, mask = (each.repeat_interleave(2, 0).repeat_interleave(2, 1) for each in (soft, MASK))
    survey = measure_detail([double], [mask], 2 * LENGTH)
    large, small = measure_form(double, mask, 2 * LENGTH, survey), form_of(soft)
    assert shares(large) == pytest.approx(shares(small), abs=0.1)
    for one, other in zip(large.detail, small.detail, strict=True):
        shrunk = one.reshape(SIDE, 2, SIDE, 2).mean(dim=(1, 3))
        assert (shrunk - other).abs().max() < 0.15 * other.abs().max() + 0.01


def test_a_large_view_is_pooled_and_has_the_same_form():
    survey, length = measure_detail([WITH_EYE], [MASK], LENGTH), 6 * LENGTH
    large = torch.nn.Upsample(scale_factor=6)
    mask = large(MASK[None, None].float())[0, 0] > 0

    def enlarge(image: Tensor) -> Tensor:
        there = torch.where(MASK[..., None], image, SOME)  # what lies beside it has no part in it
        return large(there.permute(2, 0, 1)[None])[0].permute(1, 2, 0)

    before = enlarge(WITH_EYE)
    own = PooledMask.of(mask, length)
    form = measure_form(own.average(before), own.mask, own.length, survey)
    for after in map(enlarge, (grey(PLAIN), WITH_EYE, DOTTED)):
        exact = form_distance(after, length, measure_form(before, mask, length, survey))
        pooled = own.average(after)
        assert len(pooled) == len(own.mask) == 3 * SIDE
        found = form_distance(pooled, own.length, form)
        torch.testing.assert_close(found, exact, atol=0.02, rtol=0)


FINE = enlarged(CAMERAS, 4)
TO_EYE = torch.nn.functional.normalize(FINE.positions[0], dim=0)  # from the ball, nearly
AROUND_EYE = WAYS @ TO_EYE > math.cos(math.radians(25))
ON_EYE = WAYS @ TO_EYE > math.cos(math.radians(9))
FAST = StyleConfig(steps=100, block=2, scale=1.0, object_size=60, lr=0.4, quality="draft")
BALL = dense_ball(LIGHT - 0.35 * ON_EYE[:, None])


def luminance(splats: Splats) -> Tensor:
    """Of the side with the eye, around it."""
    window = torch.zeros_like(PICKED)
    window[PICKED] = AROUND_EYE
    seen = coverage(BALL, FINE[0], window) > 0.9
    assert seen.sum() > 100
    return (rasterize(splats, FINE[0])[0][0] @ LUMA)[seen]


def test_painted_objects_keep_their_eyes_if_their_form_is_kept(
    network: FeatureNetwork, stripes: Tensor
):
    def kept(form: float) -> float:
        config = replace(FAST, form=form)
        painted = paint(BALL, FINE, PICKED, stripes, config=config, network=network)
        return float(torch.corrcoef(torch.stack([luminance(BALL), luminance(painted)]))[0, 1])

    assert kept(1.0) > max(kept(0.0) + 0.1, 0.45)


def test_relief_is_where_the_form_is(network: FeatureNetwork):
    """Darker on the eye than around it, faint elsewhere."""
    boxes = find_boxes(BALL, FINE, PICKED)
    views = cropped(BALL, boxes, PICKED, network, max_memory=1e9)
    survey = FormSurvey((5e-4, 5e-4), (1.0, 1.0), torch.zeros(3))
    own = form_relief(BALL, views, COUNT, typical_length(boxes), survey).sum(dim=1)
    sides = WAYS @ TO_EYE
    ring = AROUND_EYE & ~ON_EYE & (sides > math.cos(math.radians(13)))
    assert own[ON_EYE].mean() < -0.05 < 0 < own[ring].mean()
    # its bumps are form, too
    assert own[(sides < 0) & (WAYS[:, 2] > 0)].abs().mean() < 0.25 * own[ON_EYE].abs().mean()


def test_what_lies_in_the_dark_stands_out_as_much_as_in_the_light():
    """Two eyes of the same contrast relative to what is around, one in a tenth of the light."""
    light = torch.where(XS < 0, 0.08, 0.8)
    eyes = grey(light * (1 - 0.4 * spot(*EYE) - 0.4 * spot(-EYE[0] - 8, EYE[1])))
    form = form_of(eyes)
    bright = form.detail[:, NEAR_EYE].abs().max()
    near = spot(-EYE[0] - 8, EYE[1], RADIUS + 2) > 0
    dark = form.detail[:, near].abs().max()
    assert dark > 0.25 * bright, "in plain luminance a tenth"


def test_an_object_with_parts_has_form_in_all_bands():
    """Even in one band of sizes alone it has no pattern all over."""
    survey = measure_detail([WITH_EYE], [MASK], LENGTH)
    one = survey._replace(variations=[0.5, 1.2])
    assert one.unevenness == 1.0 and survey._replace(variations=[0.5, 0.6]).unevenness == 0.0
    assert min(shares(measure_form(WITH_EYE, MASK, LENGTH, one))) > 0
