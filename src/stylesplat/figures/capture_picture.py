"""A capture from above and from the side: its cameras, its points and the sides it covers."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw
from torch import Tensor

from stylesplat.figures.grid import INK, Row, add_legend, draw_grid
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import move_cameras
from stylesplat.structure_from_motion.diagnostics import CaptureReport
from stylesplat.structure_from_motion.world_frame import WORLD_STRIDE

CAPTURE_PANEL = 720  # pixels along a side of a panel
OVERSAMPLING = 2  # panels are drawn larger by this, for smooth lines
GROUND = (238, 239, 240)
# The axes of the two panels to the right and upwards, in the working frame (y is down)
FROM_ABOVE, FROM_SIDE = ((1.0, 0, 0), (0, 0, 1.0)), ((0, 0, 1.0), (0, -1.0, 0))
FIRST, LAST = (96, 44, 168), (0, 158, 190)  # cameras by their order
BLURRED_RED, WEAK = (214, 40, 40), (240, 145, 20)
COVERED_GREEN, UNCOVERED = (20, 140, 70), (205, 85, 60)
DASH = math.radians(3)  # length of a dash along a gap, and of the space between two
CAPTURE_MAX_POINTS = 60_000
POINTS_SHOWN = (0.04, 0.96)  # quantiles of the points that fit in; others may lie outside
FRUSTUM, CROSS = 0.07, 0.014  # of a panel's width: length of a camera, of half the middle's cross
CAPTURE_RIM = 1.08  # radius of the arc around the cameras, relative to their distance
CAPTURE_PADDING = 1.16  # of the panels, relative to what has to fit in

Rgb8 = tuple[int, ...]
Polyline = Float[Tensor, "_ 3"]


@dataclass(frozen=True, eq=False)
class _Panel:
    """A view along an axis; `scale` is pixels of `image` per unit of the working frame."""

    axes: Float[Tensor, "2 3"]
    centre: Float[Tensor, "3"]
    scale: float
    image: Image.Image

    def pixels(self, points: Float[Tensor, "M 3"]) -> Float[Tensor, "M 2"]:
        flat = (points.double() - self.centre) @ self.axes.T * self.scale
        return flat * torch.tensor([1.0, -1.0]).double() + self.image.width / 2

    def draw_line(self, points: Polyline, color: Rgb8, width: int = 1) -> None:
        places = [(x, y) for x, y in self.pixels(points).tolist()]
        ImageDraw.Draw(self.image).line(places, color, width * OVERSAMPLING, "curve")

    def draw_points(self, points: Float[Tensor, "M 3"], rgb: UInt8[Tensor, "M 3"]) -> None:
        """Draw points as squares in their colours, the nearest last."""
        order = (points @ torch.linalg.cross(*self.axes)).argsort()
        draw, side = ImageDraw.Draw(self.image), 2 * OVERSAMPLING - 1
        places = self.pixels(points)[order].floor().int().tolist()
        for (x, y), color in zip(places, rgb[order].tolist(), strict=True):
            draw.rectangle((x, y, x + side, y + side), tuple(color))


def capture_picture(capture: Capture, report: CaptureReport) -> UInt8[Tensor, "H W 3"]:
    """Draw cameras and points from above and from the side, up being up.

    Cameras are coloured by their order, those of blurred photos red and those that few points
    connect with others orange. A circle around the cameras shows the sides that they cover.
    """
    points = torch.zeros(0, 3) if capture.points is None else capture.points
    colors = capture.point_colors
    colors = torch.full(points.shape, 90).byte() if colors is None else colors
    some = slice(None, None, max(1, len(points) // CAPTURE_MAX_POINTS))
    placed = report.frame.place(points[some].double())
    covered, gaps = _arcs(report)
    centre, units = _extent(capture, report, placed, covered + gaps)
    side = CAPTURE_PANEL * OVERSAMPLING
    images = []
    for axes in (FROM_ABOVE, FROM_SIDE):
        image = Image.new("RGB", (side, side), GROUND)
        panel = _Panel(torch.tensor(axes).double(), centre, side / units, image)
        panel.draw_points(placed, colors[some])
        if axes == FROM_ABOVE:
            for arc in covered:
                panel.draw_line(arc, COVERED_GREEN, 3)
            for arc in gaps:
                for start in range(0, len(arc) - 1, 2):
                    panel.draw_line(arc[start : start + 2], UNCOVERED, 2)
        for axis in panel.axes:
            panel.draw_line(torch.stack([-axis, axis]) * CROSS * units, INK)
        for color, lines in _camera_lines(capture, report, FRUSTUM * units):
            for line in lines:
                panel.draw_line(line, color)
            ((x, y),) = panel.pixels(lines[0][:1]).tolist()
            ImageDraw.Draw(image).circle((x, y), 2 * OVERSAMPLING, color)
        images.append(torch.from_numpy(np.array(image.reduce(OVERSAMPLING))))
    name = "" if capture.path is None else f"{capture.path.resolve().name}, "
    coverage = report.coverage
    captions = (
        f"{name}{len(capture)} photos, {len(points):,} points, from above\n{coverage.arc:.0f} of "
        f"360 degrees are covered, the largest gap is {coverage.largest_gap:.0f}",
        f"from the side: {coverage.elevations}\n"
        f"Each panel is {units / report.frame.scale:.3g} units wide",
    )
    key = [("first photo", FIRST), ("last photo", LAST)]
    key += [(f"blurred ({len(report.blurred)})", BLURRED_RED)] if report.blurred else []
    key += [(f"hardly connected ({len(report.weak)})", WEAK)] if report.weak else []
    key += [("covered sides", COVERED_GREEN)]
    key += [("not covered", UNCOVERED)] if coverage.arc < 360 else []
    return add_legend(draw_grid([Row([*zip(images, captions, strict=True)])]), key)


def _arcs(report: CaptureReport) -> tuple[list[Polyline], list[Polyline]]:
    """Lines on a circle around the cameras: over the covered sides, and over the gaps."""
    sides = report.coverage.sides.deg2rad().tolist()
    radius = CAPTURE_RIM * report.coverage.far
    covered, gaps = list[Tensor](), list[Tensor]()
    for one, two in zip(sides, [*sides[1:], sides[0] + 2 * math.pi] if sides else [], strict=True):
        if two > one:
            turns = torch.linspace(one, two, 2 + round((two - one) / DASH), dtype=torch.float64)
            arc = torch.stack([turns.sin() * radius, 0 * turns, -turns.cos() * radius], dim=1)
            (covered if two - one <= WORLD_STRIDE else gaps).append(arc)
    return covered, gaps


def _extent(
    capture: Capture, report: CaptureReport, points: Float[Tensor, "M 3"], arcs: list[Polyline]
) -> tuple[Float[Tensor, "3"], float]:
    """The middle of the panels, and their width: all cameras and most points fit in."""
    cameras = report.frame.place(capture.cameras.positions.double())
    places = torch.cat([cameras, *arcs, torch.zeros(1, 3).double()])
    low, high = places.amin(dim=0), places.amax(dim=0)
    if len(points):
        reach = float((high - low).max()) + 1
        near, far = points.quantile(torch.tensor(POINTS_SHOWN).double(), dim=0)
        low = torch.minimum(low, near.clamp(min=-reach))
        high = torch.maximum(high, far.clamp(max=reach))
    return (low + high) / 2, CAPTURE_PADDING * float((high - low).max().clamp(min=1e-6))


def _camera_lines(
    capture: Capture, report: CaptureReport, length: float
) -> Iterator[tuple[Rgb8, list[Polyline]]]:
    """The colour of each camera, and a pyramid of this length; its lines begin at the camera."""
    cameras = move_cameras(capture.cameras, report.frame)
    for row, name in enumerate(cameras.names):
        share = row / max(len(cameras) - 1, 1)
        color = tuple(round((1 - share) * a + share * b) for a, b in zip(FIRST, LAST, strict=True))
        color = BLURRED_RED if name in report.blurred else WEAK if name in report.weak else color
        width, height = cameras.sizes[row].tolist()
        corners = [(0.0, 0.0, 1.0), (width, 0.0, 1.0), (width, height, 1.0), (0.0, height, 1.0)]
        rays = torch.tensor(corners).double() @ torch.linalg.inv(cameras.Ks[row].double()).T
        rays = rays * length / rays.norm(dim=1, keepdim=True)
        eye = cameras.positions[row].double()
        rim = eye + rays @ cameras.viewmats[row, :3, :3].double()
        yield color, [torch.stack([eye, corner]) for corner in rim] + [torch.cat([rim, rim[:1]])]
