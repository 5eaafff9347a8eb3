"""A capture from above and from the side: its cameras, its points and the sides it covers."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.figures.grid import INK, MARGIN, Row, draw_grid, legend, stacked
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import seen_from
from stylesplat.structure_from_motion.capture_statistics import STRIDE
from stylesplat.structure_from_motion.diagnostics import CaptureReport

PANEL = 720  # pixels along a side of a panel
BITS = 4  # fractional bits of the coordinates that cv2 draws at
GROUND = (238, 239, 240)
# The axes of the two panels to the right and upwards, in the working frame (y is down)
ABOVE, SIDE = ((1.0, 0, 0), (0, 0, 1.0)), ((0, 0, 1.0), (0, -1.0, 0))
FIRST, LAST = (96, 44, 168), (0, 158, 190)  # cameras by their order
BLURRED, WEAK = (214, 40, 40), (240, 145, 20)
SEEN, UNSEEN, BEHIND_WALL = (20, 140, 70), (205, 85, 60), (150, 152, 158)
DASH = math.radians(3)  # and as much between two
MAX_POINTS = 60_000
POINTS_SHOWN = (0.04, 0.96)  # quantiles of the points that fit in; others may lie outside
FRUSTUM = 0.07  # of a panel's width: length of a camera
RIM = 1.08  # radius of the arc around the cameras, relative to their distance


def capture_picture(capture: Capture, report: CaptureReport) -> UInt8[Tensor, "H W 3"]:
    """Draw cameras and points from above and from the side, up being up.

    Returns:
        The picture. Cameras are coloured by their order, those of blurred photos red and those
        that few points connect with others orange. A circle around the cameras shows the sides
        that they cover.
    """
    centre, scale = _centre_and_scale(capture, report)
    images = []
    for number, axes in enumerate((ABOVE, SIDE)):
        panel = _Panel(torch.tensor(axes).double(), centre, scale, _paper())
        _draw_points(panel, capture, report)
        if number == 0:
            _draw_sides(panel, report)
        _draw_cameras(panel, capture, report)
        images.append(torch.from_numpy(panel.image))
    page = draw_grid([Row([*zip(images, _captions(capture, report, scale), strict=True)])])
    return stacked(page, legend(_legend(report), page.shape[1] - 2 * MARGIN))


@dataclass(frozen=True)
class _Panel:
    """A view along an axis, in pixels."""

    axes: Float[Tensor, "2 3"]
    centre: Float[Tensor, "3"]
    scale: float
    image: UInt8[np.ndarray, "S S 3"]

    def places(self, points: Float[Tensor, "M 3"]) -> Float[Tensor, "M 2"]:
        """Pixels, of which y counts downwards."""
        flat = (points.double() - self.centre) @ self.axes.T * self.scale
        return flat * torch.tensor([1.0, -1.0]).double() + PANEL / 2

    def draw_line(self, points: Float[Tensor, "M 3"], color: tuple[int, ...], width: int) -> None:
        places = (self.places(points) * 2**BITS).round().int().numpy()
        cv2.polylines(self.image, [places], False, color, width, cv2.LINE_AA, BITS)


def _paper() -> UInt8[np.ndarray, "S S 3"]:
    return np.full((PANEL, PANEL, 3), GROUND, np.uint8)


def _centre_and_scale(capture: Capture, report: CaptureReport) -> tuple[Float[Tensor, "3"], float]:
    """The middle of the panels, and a scale at which all cameras and most points fit in."""
    rim = _arcs(report, covered=True)
    rim += [] if report.coverage.facing else _arcs(report, covered=False)
    places = torch.cat([report.frame.place(capture.cameras.positions.double()), *rim])
    places = torch.cat([places, torch.zeros(1, 3).double()])
    low, high = places.amin(dim=0), places.amax(dim=0)
    reach = float((high - low).max())
    if capture.points is not None and len(capture.points):
        points = report.frame.place(_some(capture.points).double())
        near, far = points.quantile(torch.tensor(POINTS_SHOWN).double(), dim=0)
        low = torch.minimum(low, near.clamp(min=-reach - 1))
        high = torch.maximum(high, far.clamp(max=reach + 1))
    return (low + high) / 2, PANEL / (1.16 * float((high - low).max().clamp(min=1e-6)))


def _some(points: Tensor) -> Tensor:
    return points[:: max(1, len(points) // MAX_POINTS)]


def _draw_points(panel: _Panel, capture: Capture, report: CaptureReport) -> None:
    """Draw points in their colours, the nearest last."""
    points, colors = capture.points, capture.point_colors
    if points is None or not len(points):
        return
    placed = report.frame.place(_some(points).double())
    rgb = torch.full((len(placed), 3), 90) if colors is None else _some(colors)
    order = (placed @ torch.linalg.cross(panel.axes[0], panel.axes[1])).argsort()
    places = panel.places(placed)[order].floor().long()
    for offset in ((0, 0), (1, 0), (0, 1), (1, 1)):
        spots = places + torch.tensor(offset)
        inside = ((spots >= 0) & (spots < PANEL)).all(dim=1)
        x, y = spots[inside].T.numpy()
        panel.image[y, x] = rgb[order][inside].byte().numpy()


def _draw_sides(panel: _Panel, report: CaptureReport) -> None:
    for arc in _arcs(report, covered=True):
        panel.draw_line(arc, SEEN, 3)
    color = BEHIND_WALL if report.coverage.facing else UNSEEN
    for arc in _arcs(report, covered=False):
        for start in range(0, len(arc) - 1, 2):
            panel.draw_line(arc[start : start + 2], color, 2)


def _draw_cameras(panel: _Panel, capture: Capture, report: CaptureReport) -> None:
    cross = 10 / panel.scale
    for axis in panel.axes:  # the middle of the content
        panel.draw_line(torch.stack([-cross * axis, cross * axis]), INK, 1)
    cameras = seen_from(capture.cameras, report.frame)
    depth = FRUSTUM * PANEL / panel.scale
    for row, color in enumerate(_colors(capture, report)):
        K, (width, height) = cameras.Ks[row].double(), cameras.sizes[row].tolist()
        corners = torch.tensor([(0, 0, 1.0), (width, 0, 1), (width, height, 1), (0, height, 1)])
        rays = corners.double() @ torch.linalg.inv(K).T
        rays = rays * depth / rays.norm(dim=1, keepdim=True)
        eye = cameras.positions[row].double()
        rim = eye + rays @ cameras.viewmats[row, :3, :3].double()
        panel.draw_line(torch.cat([rim, rim[:1]]), color, 1)
        for corner in rim:
            panel.draw_line(torch.stack([eye, corner]), color, 1)
        panel.draw_line(torch.stack([eye, eye]), color, 4)


def _colors(capture: Capture, report: CaptureReport) -> list[tuple[int, ...]]:
    colors = []
    for row, name in enumerate(capture.cameras.names):
        share = row / max(1, len(capture) - 1)
        color = tuple(round((1 - share) * a + share * b) for a, b in zip(FIRST, LAST, strict=True))
        color = WEAK if name in report.weak else color
        colors.append(BLURRED if name in report.blurred else color)
    return colors


def _arcs(report: CaptureReport, *, covered: bool) -> list[Float[Tensor, "M 3"]]:
    """Lines on the circle around the cameras, over the covered sides or over the gaps."""
    sides = report.coverage.sides.deg2rad().tolist()
    radius = RIM * report.coverage.far
    arcs = []
    for one, two in zip(sides, [*sides[1:], sides[0] + 2 * math.pi] if sides else [], strict=True):
        if ((two - one) <= STRIDE) == covered and two > one:
            turns = torch.linspace(one, two, 2 + round((two - one) / DASH), dtype=torch.float64)
            arc = [turns.sin() * radius, 0 * turns, -turns.cos() * radius]
            arcs.append(torch.stack(arc, dim=1))
    return arcs


def _captions(capture: Capture, report: CaptureReport, scale: float) -> tuple[str, str]:
    name = "" if capture.path is None else f"{capture.path.resolve().name}, "
    points = 0 if capture.points is None else len(capture.points)
    coverage, units = report.coverage, PANEL / (scale * report.frame.scale)
    return (
        f"{name}{len(capture)} photos, {points:,} points, from above\n"
        f"{coverage.arc:.0f} of 360 degrees are covered, the largest gap is "
        f"{coverage.largest_gap:.0f}",
        f"from the side: {coverage.elevations}\nEach panel is {units:.3g} units wide",
    )


def _legend(report: CaptureReport) -> list[tuple[str, tuple[int, ...]]]:
    gap = BEHIND_WALL if report.coverage.facing else UNSEEN
    return [
        ("first photo", FIRST),
        ("last photo", LAST),
        *([(f"blurred ({len(report.blurred)})", BLURRED)] if report.blurred else []),
        *([(f"hardly connected ({len(report.weak)})", WEAK)] if report.weak else []),
        ("covered sides", SEEN),
        *([("not covered", gap)] if report.coverage.arc < 360 else []),
    ]
