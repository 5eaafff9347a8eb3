"""A capture from above and from the side: where the cameras stand, and what they found."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.figures.grid import COUNT_SIZE, INK, MARGIN, PAPER, TITLE_SIZE, write_line
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import seen_from
from stylesplat.structure_from_motion.capture_report import CaptureReport
from stylesplat.structure_from_motion.coverage import STRIDE

FINE = 2  # times the size at which all but the text is drawn, so that edges are smooth
PANEL = 720  # pixels along a side of a panel
HEAD, FOOT = 2 * TITLE_SIZE + 8, 2 * COUNT_SIZE + 18  # pixels of height above and below the panels
GROUND = (238, 239, 240)
# What the two panels show to the right and upwards, in the working frame (y is down)
ABOVE, SIDE = ((1.0, 0, 0), (0, 0, 1.0)), ((0, 0, 1.0), (0, -1.0, 0))
FIRST, LAST = (96, 44, 168), (0, 158, 190)  # cameras by their order
BLURRED, WEAK = (214, 40, 40), (240, 145, 20)
SEEN, UNSEEN, BEHIND_WALL = (20, 140, 70), (205, 85, 60), (150, 152, 158)
ARC, GAP = 3, 2  # pixels of width
DASH = math.radians(3)  # and as much between two
MAX_POINTS = 60_000
INK_OF_POINTS = 0.8  # share of a point's colour against the ground
POINTS_SHOWN = (0.04, 0.96)  # quantiles of the points that fit in; others may lie outside
FRUSTUM = 0.07  # of a panel's width: length of a camera
RIM = 1.08  # how far outside the cameras the arc runs, relative to their distance


@dataclass(frozen=True)
class _Panel:
    """One view along an axis, in pixels of the fine picture."""

    axes: Float[Tensor, "2 3"]
    centre: Float[Tensor, "2"]
    scale: float

    def places(self, points: Float[Tensor, "M 3"]) -> Float[Tensor, "M 2"]:
        """Pixels within the panel; y counts downwards."""
        flat = (points.double() @ self.axes.T - self.centre) * self.scale
        return flat * torch.tensor([1.0, -1.0]).double() + FINE * PANEL / 2


def capture_picture(capture: Capture, report: CaptureReport) -> UInt8[Tensor, "H W 3"]:
    """Draw cameras and points from above and from the side, up being up.

    Args:
        capture: Posed photos.
        report: What `check` found of it.

    Returns:
        The picture. Cameras are coloured by their order, those of blurred photos red and those
        that few points connect with others orange; around them the sides that they cover.
    """
    width = 2 * PANEL + 3 * MARGIN
    sheet = Image.new("RGB", (width, HEAD + PANEL + FOOT), PAPER)
    panels = _panels(capture, report)
    for number, panel in enumerate(panels):
        drawn = _draw_panel(panel, capture, report, from_above=number == 0)
        sheet.paste(drawn, (MARGIN + number * (PANEL + MARGIN), HEAD))
    _write(sheet, capture, report, panels[0].scale / FINE)
    return torch.from_numpy(np.array(sheet))


def _panels(capture: Capture, report: CaptureReport) -> tuple[_Panel, _Panel]:
    """Both at one scale, at which all cameras and nearly all points fit in."""
    places = [report.frame.place(capture.cameras.positions.double()), _rim(report)]
    low, high = torch.cat(places).amin(dim=0), torch.cat(places).amax(dim=0)
    reach = float((high - low).max())
    if capture.points is not None and len(capture.points):
        points = report.frame.place(capture.points.double())
        points = points[:: max(1, len(points) // MAX_POINTS)]
        near, far = points.quantile(torch.tensor(POINTS_SHOWN).double(), dim=0)
        low = torch.minimum(low, near.clamp(min=-reach - 1))
        high = torch.maximum(high, far.clamp(max=reach + 1))
    scale = FINE * PANEL / (1.16 * float((high - low).max().clamp(min=1e-6)))
    middle = (low + high) / 2
    views = (torch.tensor(axes).double() for axes in (ABOVE, SIDE))
    one, two = (_Panel(axes, axes @ middle, scale) for axes in views)
    return one, two


def _draw_panel(
    panel: _Panel, capture: Capture, report: CaptureReport, *, from_above: bool
) -> Image.Image:
    drawn = Image.fromarray(_point_layer(panel, capture, report))
    draw = ImageDraw.Draw(drawn, "RGBA")
    if from_above:
        unseen = BEHIND_WALL if report.coverage.facing else UNSEEN
        for line in [dash for gap in _arcs(report, seen=False) for dash in _dashes(gap)]:
            draw.line(_pixels(panel.places(line)), unseen, FINE * GAP)
        for line in _arcs(report, seen=True):
            draw.line(_pixels(panel.places(line)), SEEN, FINE * ARC, "curve")
    x, y = panel.places(torch.zeros(1, 3))[0].tolist()
    draw.line([(x - 10 * FINE, y), (x + 10 * FINE, y)], (*INK, 255), FINE)
    draw.line([(x, y - 10 * FINE), (x, y + 10 * FINE)], (*INK, 255), FINE)
    _draw_cameras(draw, panel, capture, report)
    return drawn.resize((PANEL, PANEL), Image.Resampling.LANCZOS)


def _point_layer(
    panel: _Panel, capture: Capture, report: CaptureReport
) -> UInt8[np.ndarray, "S S 3"]:
    """Points in their colours, what is nearer to the eye over what is farther."""
    side = FINE * PANEL
    layer = np.full((side, side, 3), GROUND, np.uint8)
    points, colors = capture.points, capture.point_colors
    if points is None or not len(points):
        return layer
    step = max(1, len(points) // MAX_POINTS)
    placed = report.frame.place(points[::step].double())
    rgb = torch.full((len(placed), 3), 90.0) if colors is None else colors[::step].float()
    nearness = placed @ torch.linalg.cross(panel.axes[0], panel.axes[1])
    order = nearness.argsort()
    places = panel.places(placed)[order].round().long()
    rgb = INK_OF_POINTS * rgb[order] + (1 - INK_OF_POINTS) * torch.tensor(GROUND)
    disc = torch.cartesian_prod(torch.arange(-2, 3), torch.arange(-2, 3))
    disc = disc[disc.square().sum(dim=1) <= 5]
    spots = (places[:, None] + disc).flatten(0, 1)
    inside = ((spots >= 0) & (spots < side)).all(dim=1)
    x, y = spots[inside].T.numpy()
    layer[y, x] = rgb.round().byte().repeat_interleave(len(disc), dim=0)[inside].numpy()
    return layer


def _draw_cameras(
    draw: ImageDraw.ImageDraw, panel: _Panel, capture: Capture, report: CaptureReport
) -> None:
    cameras = seen_from(capture.cameras, report.frame)
    depth = FRUSTUM * FINE * PANEL / panel.scale
    for row, color in enumerate(_colors(capture, report)):
        K, (width, height) = cameras.Ks[row].double(), cameras.sizes[row].tolist()
        corners = torch.tensor([(0, 0, 1.0), (width, 0, 1), (width, height, 1), (0, height, 1)])
        rays = corners.double() @ torch.linalg.inv(K).T
        rays = rays * depth / rays.norm(dim=1, keepdim=True)
        rotation = cameras.viewmats[row, :3, :3].double()
        apex = cameras.positions[row].double()
        outline = _pixels(panel.places(torch.cat([apex[None], apex + rays @ rotation])))
        eye, *rim = outline
        for one, two in zip(rim, [*rim[1:], rim[0]], strict=True):
            draw.polygon([eye, one, two], (*color, 40))
            draw.line([eye, one, two], (*color, 255), FINE)
        x, y = eye
        draw.ellipse((x - 2 * FINE, y - 2 * FINE, x + 2 * FINE, y + 2 * FINE), (*color, 255))


def _colors(capture: Capture, report: CaptureReport) -> list[tuple[int, int, int]]:
    count = len(capture)
    colors = []
    for row, name in enumerate(capture.cameras.names):
        share = row / max(1, count - 1)
        color = tuple(round((1 - share) * a + share * b) for a, b in zip(FIRST, LAST, strict=True))
        if name in report.weak:
            color = WEAK
        if name in report.blurred:
            color = BLURRED
        colors.append(color)
    return colors


def _arcs(report: CaptureReport, *, seen: bool) -> list[Float[Tensor, "M 3"]]:
    """Lines on the circle around the cameras, over the sides that are covered or over the gaps."""
    sides = report.coverage.sides.deg2rad().tolist()
    radius = RIM * report.coverage.far
    arcs = []
    for one, two in zip(sides, [*sides[1:], sides[0] + 2 * math.pi] if sides else [], strict=True):
        if ((two - one) <= STRIDE) == seen and two > one:
            turns = torch.linspace(one, two, 2 + round((two - one) / DASH), dtype=torch.float64)
            arcs.append(
                torch.stack([turns.sin() * radius, 0 * turns, -turns.cos() * radius], dim=1)
            )
    return arcs


def _dashes(line: Float[Tensor, "M 3"]) -> list[Float[Tensor, "2 3"]]:
    return [line[start : start + 2] for start in range(0, len(line) - 1, 2)]


def _rim(report: CaptureReport) -> Float[Tensor, "M 3"]:
    """What of the circle has to show: all of it, but behind a wall nothing is missing."""
    arcs = _arcs(report, seen=True)
    arcs += [] if report.coverage.facing else _arcs(report, seen=False)
    return torch.cat([torch.zeros(1, 3).double(), *arcs])


def _pixels(places: Float[Tensor, "M 2"]) -> list[tuple[float, float]]:
    return [(x, y) for x, y in places.tolist()]


def _write(sheet: Image.Image, capture: Capture, report: CaptureReport, scale: float) -> None:
    """Title, captions, legend and scale; `scale` is in pixels per unit of the working frame."""
    name = "" if capture.path is None else f"{capture.path.resolve().name}: "
    points = 0 if capture.points is None else len(capture.points)
    write_line(
        sheet,
        (MARGIN, MARGIN // 2),
        f"{name}{len(capture)} photos, {points:,} points",
        TITLE_SIZE,
        PANEL,
    )
    second, heights = 2 * MARGIN + PANEL, f"from the side: {report.coverage.elevations}"
    for left, text in ((MARGIN, _sides(report)), (second, heights)):
        write_line(sheet, (left + 2, HEAD + PANEL + 6), text, COUNT_SIZE, PANEL)
    _draw_legend(sheet, report, HEAD + PANEL + COUNT_SIZE + 14)
    _draw_scale(sheet, scale * report.frame.scale)


def _sides(report: CaptureReport) -> str:
    coverage = report.coverage
    return (
        f"from above: {coverage.arc:.0f} of 360 degrees are covered, "
        f"the largest gap is {coverage.largest_gap:.0f}"
    )


def _draw_legend(sheet: Image.Image, report: CaptureReport, top: int) -> None:
    draw, left = ImageDraw.Draw(sheet), MARGIN + 2
    gap = BEHIND_WALL if report.coverage.facing else UNSEEN
    entries = [
        (FIRST, "first photo"),
        (LAST, "last photo"),
        *([(BLURRED, f"blurred ({len(report.blurred)})")] if report.blurred else []),
        *([(WEAK, f"hardly connected ({len(report.weak)})")] if report.weak else []),
        (SEEN, "sides that are covered"),
        *([(gap, "not covered")] if report.coverage.arc < 360 else []),
    ]
    for color, text in entries:
        draw.rectangle((left, top + 3, left + 11, top + 14), color)
        write_line(sheet, (left + 18, top), text, COUNT_SIZE, PANEL)
        left += 18 + round(ImageFont.load_default(COUNT_SIZE).getlength(text)) + 22


def _draw_scale(sheet: Image.Image, scale: float) -> None:
    """A bar of a round length in the capture's units, in the second panel's corner."""
    longest = PANEL / 4 / scale
    unit = 10.0 ** math.floor(math.log10(longest))
    length = max(step * unit for step in (1, 2, 5) if step * unit <= longest)
    right, y = 2 * (MARGIN + PANEL) - 14, HEAD + PANEL - 16
    left = right - round(length * scale)
    draw = ImageDraw.Draw(sheet)
    draw.line([(left, y), (right, y)], INK, 2)
    for x in (left, right):
        draw.line([(x, y - 5), (x, y + 5)], INK, 2)
    text = f"{length:g} " + ("unit" if length == 1 else "units")
    write_line(sheet, (left, y - COUNT_SIZE - 10), text, COUNT_SIZE, PANEL)
