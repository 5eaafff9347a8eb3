"""Draw docs/coverage.jpg: the demo scene photographed from all sides, and from one only.

Usage: python scripts/coverage_picture.py docs/coverage.jpg
"""

import argparse
from pathlib import Path

from PIL import Image

from still_life.photos import dome_cameras, photograph, surface_points
from stylesplat.figures.capture_picture import capture_picture
from stylesplat.figures.grid import MARGIN, PAPER, TITLE_SIZE, write_line
from stylesplat.io.atomic import atomic_path
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.structure_from_motion.diagnostics import CaptureReport
from stylesplat.verbs.check import check

CAMERAS = dome_cameras(48, 240, 180)
ONE_SIDE = [*range(6), *range(24, 30)]  # of both rings
POINTS = 200  # a photo: as many as structure from motion would find
WIDTH = 1100  # pixels of the picture
QUALITY = 82


def main() -> None:
    """Make both captures, check them, and write what comes of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    output = parser.parse_args().output
    drawn = [_drawn(CAMERAS), _drawn(CAMERAS[ONE_SIDE])]
    sheet = Image.new("RGB", (drawn[0].width, sum(each.height for each in drawn)), PAPER)
    sheet.paste(drawn[0], (0, 0))
    sheet.paste(drawn[1], (0, drawn[0].height))
    sheet.thumbnail((WIDTH, 2 * WIDTH), Image.Resampling.LANCZOS)
    with atomic_path(output) as temporary:
        sheet.save(temporary, quality=QUALITY)


def _drawn(cameras: Cameras) -> Image.Image:
    """The picture of a capture, under what is said of its sides."""
    capture = _photographed(cameras)
    report = check(capture)
    picture = Image.fromarray(capture_picture(capture, report).numpy())
    head = 2 * TITLE_SIZE
    sheet = Image.new("RGB", (picture.width, head + picture.height + MARGIN), PAPER)
    write_line(sheet, (MARGIN, MARGIN), _verdict(report), TITLE_SIZE, picture.width)
    sheet.paste(picture, (0, head))
    return sheet


def _photographed(cameras: Cameras) -> Capture:
    views = list(photograph(cameras, 0))
    points, colors = surface_points(cameras, views, POINTS * len(views))
    content = points.norm(dim=1) < 3  # not the ground far below
    photos = [view.photo for view in views]
    return Capture(cameras, photos, points=points[content], point_colors=colors[content])


def _verdict(report: CaptureReport) -> str:
    sides = next(each for each in report.findings if each.what == "sides")
    return f"{sides.verdict}: {sides.line}"


if __name__ == "__main__":
    main()
