"""Draw docs/coverage.jpg: the demo scene photographed from all sides, and from one only.

Usage: python scripts/coverage_picture.py docs/coverage.jpg
"""

import argparse
from pathlib import Path

from PIL import Image

from still_life.photos import arrange, dome_cameras, photograph, surface_points
from stylesplat.figures.capture_picture import capture_picture
from stylesplat.figures.grid import Row, draw_grid
from stylesplat.io.atomic import atomic_path
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.verbs.sfm import check

CAMERAS = dome_cameras(48, 240, 180)
ONE_SIDE = [*range(6), *range(24, 30)]  # of both rings
POINTS = 200  # a photo: as many as structure from motion would find
WIDTH = 1100  # pixels of the picture
QUALITY = 82


def main() -> None:
    """Make both captures, check them, and write their pictures with the verdicts on their sides."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    output = parser.parse_args().output
    rows = []
    for cameras in (CAMERAS, CAMERAS[ONE_SIDE]):
        capture = _photographed(cameras)
        report = check(capture)
        sides = next(each for each in report.findings if each.what == "sides")
        rows.append(Row([(capture_picture(capture, report), f"{sides.verdict}: {sides.line}")]))
    sheet = Image.fromarray(draw_grid(rows).numpy())
    sheet.thumbnail((WIDTH, 2 * WIDTH), Image.Resampling.LANCZOS)
    with atomic_path(output) as temporary:
        sheet.save(temporary, quality=QUALITY)


def _photographed(cameras: Cameras) -> Capture:
    views = list(photograph(cameras, arrange(0)))
    points, colors = surface_points(cameras, views, POINTS * len(views))
    content = points.norm(dim=1) < 3  # not the ground far below
    photos = [view.photo for view in views]
    return Capture(cameras, photos, points=points[content], point_colors=colors[content])


if __name__ == "__main__":
    main()
