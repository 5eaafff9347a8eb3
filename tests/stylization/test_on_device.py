"""Laying a canvas and cropping a scene on a GPU; on any machine, see `fake_cuda.py`."""

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from balls import CAMERAS, FAST, RED, SPLATS, ball, enlarged, same
from balls import STRIPED_SCENE as SCENE
from fake_cuda import HostTrips, cuda  # noqa: F401  (a fixture)
from stylesplat.rendering.render import colors_of
from stylesplat.rendering.visibility import in_view, pixel_bounds, visible
from stylesplat.rendering.weights import backproject, contributions, coverage
from stylesplat.selection.shares import object_shares
from stylesplat.stylization import canvas as fitting
from stylesplat.stylization import painter as cutting
from stylesplat.stylization.canvas import Canvas, build_surfels, fit_surfels, unpainted_views
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.painter import crop_scene, find_boxes
from stylesplat.stylization.painting import Painting, paint_setup
from stylesplat.stylization.trim import trim_surfels

LARGER = enlarged(CAMERAS[::4], 2)
ELSEWHERE = 20  # Gaussians that no camera sees, before all others
SOLID = SPLATS.map(torch.clone)
SOLID.opacities.fill_(6.0)


class Transfers(TorchFunctionMode):
    """Notes how many rows each tensor has that leaves the device."""

    def __init__(self) -> None:
        self.rows: list[int] = []

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        if func in (Tensor.to, Tensor.cpu) and args[0].is_cuda and not result.is_cuda:
            self.rows.append(len(result) if result.ndim else 1)
        return result


def test_what_is_visible(cuda: str):  # noqa: F811
    splats, camera = SPLATS.to(cuda), CAMERAS[0]
    low, high = pixel_bounds(SPLATS, camera)
    found_low, found_high = pixel_bounds(splats, camera)
    assert (found_low.cpu() - low).abs().max() <= 1 and (found_high.cpu() - high).abs().max() <= 1
    pixels = torch.zeros(camera.size[::-1], dtype=torch.bool)
    pixels[:, : camera.size[0] // 2] = True
    near, there = in_view(SPLATS, camera, pixels), in_view(splats, camera, pixels.to(cuda))
    assert torch.equal(there.rows.cpu(), near.rows) and 0 < len(near.rows) < len(SPLATS)
    assert torch.equal(visible(there, camera).rows.cpu(), visible(near, camera).rows)


def test_linear_views(cuda: str):  # noqa: F811
    camera, pixels = CAMERAS[0], torch.zeros(CAMERAS[0].size[::-1], dtype=torch.bool)
    pixels[10:] = True
    view = contributions(SPLATS, camera, RED)
    found = contributions(SPLATS.to(cuda), camera, RED.to(cuda))
    assert set(found.gaussians.tolist()) == set(view.gaussians.tolist())
    torch.testing.assert_close(found.coverage.cpu(), view.coverage, atol=1e-3, rtol=0)
    for some in (torch.ones_like(pixels), pixels):
        there = found.pixels_in(some.to(cuda)).cpu()
        torch.testing.assert_close(there, view.pixels_in(some), atol=1e-2, rtol=1e-2)
    images = []
    for each, splats in ((view, SPLATS), (found, SPLATS.to(cuda))):
        origin = camera.positions.to(splats.means)
        images.append(each.render(colors_of(splats, each.gaussians, origin)).cpu())
    torch.testing.assert_close(*images, atol=2e-3, rtol=0)


def test_a_look_at_a_view_hardly_waits_for_the_device(cuda: str):  # noqa: F811
    """Where Gaussians are sorted into tiles for their pairs, and for which ones are visible."""
    splats, mask, camera = SPLATS.to(cuda), RED.to(cuda), CAMERAS[0]
    image = torch.ones(*camera.size[::-1], 2).to(cuda)
    with HostTrips() as trips:
        coverage(splats, camera, mask)
        backproject(splats, camera, image)
    assert trips.found in ([], ["__int__"] * 2)  # the stand-in sorts none
    with HostTrips() as trips:
        contributions(splats, camera, mask)
    assert len(trips.found) <= 4


def test_own_shares(cuda: str):  # noqa: F811
    found = object_shares(SPLATS.to(cuda), RED.to(cuda), CAMERAS[:4]).cpu()
    torch.testing.assert_close(found, object_shares(SPLATS, RED, CAMERAS[:4]), atol=0.02, rtol=0)


@pytest.mark.usefixtures("quick_painting")
def test_the_canvas(cuda: str):  # noqa: F811
    """It covers the object, shows nowhere else, and the scene stays on the device meanwhile."""

    def laid(device: str) -> Canvas:
        splats, mask = SOLID.to(device), RED.to(device)
        boxes = find_boxes(splats, LARGER, mask)
        canvas = build_surfels(splats, mask, boxes, length=30.0, max_discs=400, seed=0)
        assert canvas is not None
        canvas = fit_surfels(canvas, seed=0)
        return trim_surfels(canvas, LARGER, painted=canvas.splats)[0]

    with Transfers() as transfers:
        found = laid(cuda)
    expected = laid("cpu")
    assert int(found.is_disc.sum()) == pytest.approx(int(expected.is_disc.sum()), rel=0.1)
    assert transfers.rows and not {len(SOLID), len(found.parents)} & {*transfers.rows}
    assert found.splats.device.type == "cuda"
    splats, is_disc = found.splats.to("cpu"), found.is_disc.cpu()
    for name, before in SOLID.tensors().items():
        assert torch.equal(splats.tensors()[name][: len(SOLID)][~RED], before[~RED]), name
    for camera in (LARGER[0], LARGER[1]):
        before, covered = (coverage(s, camera, m) for s, m in ((SOLID, RED), (splats, is_disc)))
        usual = coverage(expected.splats, camera, expected.is_disc)
        shares = [float(each[before > 0.98].mean()) for each in (covered, usual)]
        assert shares[0] == pytest.approx(shares[1], abs=0.05) and shares[1] > 0.5
        assert covered[before == 0].max() < 1e-3


@pytest.mark.usefixtures("quick_painting")
def test_fitting_never_waits_for_the_device(cuda: str, monkeypatch: pytest.MonkeyPatch):  # noqa: F811
    """Whatever it asks, it asks before its steps, but for the number of pairs to sort."""
    splats, mask = SOLID.to(cuda), RED.to(cuda)
    views = unpainted_views(splats, mask, find_boxes(splats, LARGER, mask))
    canvas, trips = replace(Canvas.without_discs(splats, mask), views=views), list[list[str]]()
    for steps in (1, 3):
        monkeypatch.setattr(fitting, "CANVAS_STEPS", steps)
        with HostTrips() as mode:
            fit_surfels(canvas, seed=0)
        trips.append(mode.found)
    few, many = map(Counter, trips)
    assert few.total() and (many - few).total() <= 2 and {*(many - few)} <= {"__int__"}


def test_crops_of_large_scenes(
    cuda: str,  # noqa: F811
    network: FeatureNetwork,
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(cutting, "VISIBLE_LARGE", 0)
    means = SCENE.means.clone()
    means[:ELSEWHERE, 2] += 1e4
    scene, rows = replace(SCENE, means=means), {}
    for device in ("cpu", cuda):
        context = paint_setup(scene.to(device), CAMERAS[:3], network.to(device))
        target = Painting("ball", ball(0).to(device), (), FAST)
        part, own = crop_scene(context, target)
        rows[device] = own.parents
        assert same(part.splats.to("cpu"), scene[rows[device].cpu()])
        assert torch.equal(own.mask.cpu(), ball(0)[rows[device].cpu()])
    assert torch.equal(rows[cuda].cpu(), rows["cpu"]) and int(rows["cpu"].min()) == ELSEWHERE
