"""The contact sheet of objects: three cut-outs of each, its label id, name and Gaussian count."""

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import (
    VIEWS,
    best_rows,
    find_views,
    small,
    visibility,
)
from stylesplat.figures.compositing import to_uint8
from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.shares import colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import solid
from stylesplat.scene.projection import crop
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import MIN_COVERAGE, object_ids, render_labels
from stylesplat.selection.pick import each_object
from stylesplat.selection.survey import survey
from stylesplat.stylization.views import SURVEY_SIZE

CELL = 256  # pixels along a cut-out
GAP = 8  # pixels between the cut-outs of one object
SMALL = (CELL - GAP) // 2  # pixels along those from other sides
MARGIN = 16  # pixels around a cut-out
CAPTION = 58  # pixels of height for the text under a cut-out
TITLE_SIZE, COUNT_SIZE = 22, 15  # pixels
PAPER, CARD = (250, 250, 248), (226, 228, 230)
INK, FAINT_INK = (25, 25, 28), (105, 105, 112)
MAX_COLUMNS = 4  # of a sheet with few objects; of many there are as many lines as columns
SURVEY_VIEWS = 24  # views searched for the best ones of each object
OVERSCAN = 0.5  # of the view on each side, to show what the photo's border cuts off
PART_SHARE = 0.2  # of the largest part's pixels, below which a part is taken for a stray
PADDING = 0.06  # of a cut-out on each side
SURROUNDINGS = 0.15  # of an object, on each side of a close-up


@torch.no_grad()
def object_sheet(
    splats: Splats,
    cameras: Cameras,
    *,
    names: Mapping[int, str] | None = None,
) -> UInt8[Tensor, "H W 3"]:
    """Draw one cell per object, so that ids need not be guessed from label maps.

    Each object is cut out of the whole scene, from the view that shows most of it and small from
    two other sides: what shows is what a viewer would see of it there.

    Args:
        splats: Gaussians with identities.
        cameras: Views to choose from.
        names: What the user calls the objects, by label id.

    Returns:
        The sheet, objects in the order of their ids.

    Raises:
        StyleSplatError: If the splats have no identities, or no objects.
    """
    ids = object_ids(splats)
    if not ids:
        raise StyleSplatError(
            "These splats have no objects: the label maps hold only background. "
            "Train with label maps that name some."
        )
    searched = evenly(range(len(cameras)), SURVEY_VIEWS)
    scores = _scores(splats, cameras, searched, ids)
    seen = survey(splats, [small(cameras[row]) for row in searched])
    cells = []
    for id, picked in track(each_object(splats, ids), "objects", unit="object", total=len(ids)):
        rows = best_rows(cameras, splats.means[solid(splats, picked)], scores[id])
        there, own = splats, picked
        if seen is not None and picked.any():
            around = seen.around(picked)
            there, own = splats[around], picked[around]
        pictures = [
            _portrait(there, own, cameras[row], side)
            for row, side in zip(rows, (CELL, *[SMALL] * (VIEWS - 1)), strict=False)
        ]
        title = " · ".join([str(id), *filter(None, [(names or {}).get(id)])])
        cells.append(_cell(pictures, title, f"{int(picked.sum()):,} Gaussians"))
    return torch.from_numpy(np.array(_grid(cells)))


@torch.no_grad()
def close_up(splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]) -> Cameras:
    """A square view of an object and a margin, from the camera that shows most of it.

    Args:
        splats: The scene.
        cameras: Views to choose from.
        picked: The object's Gaussians.

    Returns:
        One camera, named as the one it was made from.

    Raises:
        StyleSplatError: If the object shows in none of the views.
    """
    found = find_views(splats, cameras, picked, count=1)
    if not found:
        where = cameras.names[0] if len(cameras) == 1 else f"any of {len(cameras)} views"
        raise StyleSplatError(f"The object does not show in {where}. Choose a view of it.")
    best = cameras[found[0].row]
    return _aim(splats, picked, best, CELL, padding=SURROUNDINGS)


def _scores(
    splats: Splats, cameras: Cameras, rows: Sequence[int], ids: Sequence[int]
) -> dict[int, dict[int, float]]:
    """For each object how well some cameras show it; none that do not."""
    scores: dict[int, dict[int, float]] = {id: {} for id in ids}
    labelled = at_once(lambda row: render_labels(splats, small(cameras[row])), rows, splats.device)
    for row, labels in zip(
        rows, track(labelled, "looking for objects", total=len(rows)), strict=True
    ):
        for id in labels.unique().tolist():
            if id in scores:
                scores[id][row] = visibility(labels == id)
    return scores


def _portrait(
    splats: Splats, picked: Bool[Tensor, " N"], camera: Cameras, side: int
) -> UInt8[Tensor, "S S 3"]:
    """An object that fills a square picture, seen from a camera's position."""
    image, share = colors_and_coverage(splats, _aim(splats, picked, camera, side), picked)
    card = image.new_tensor(CARD) / 255
    return to_uint8(share * image + (1 - share) * card).cpu()


def _aim(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    camera: Cameras,
    side: int,
    *,
    padding: float = PADDING,
) -> Cameras:
    """The same camera, shifted and zoomed to the square around an object, for a picture of it."""
    width, height = camera.size
    step = max(width, height) / SURVEY_SIZE
    left, top = -OVERSCAN * width, -OVERSCAN * height
    wide = (round((1 + 2 * OVERSCAN) * size / step) for size in (width, height))
    survey = crop(camera, (left, top), tuple(wide), zoom=1 / step)
    _, share = colors_and_coverage(splats, survey, picked)
    box = _main_box(share[..., 0].cpu().numpy() > MIN_COVERAGE)
    if box is None:
        return crop(camera, (0.0, 0.0), (side, side), zoom=side / max(width, height))
    x0, y0, x1, y1 = box
    length = max(x1 - x0, y1 - y0) * step * (1 + 2 * padding)
    corner = (left + (x0 + x1) / 2 * step - length / 2, top + (y0 + y1) / 2 * step - length / 2)
    return crop(camera, corner, (side, side), zoom=side / length)


def _main_box(shown: Bool[np.ndarray, "h w"]) -> tuple[int, int, int, int] | None:
    """Left, top, right and bottom of the large connected parts; None if nothing shows."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(shown.astype(np.uint8))
    parts = stats[1:]  # the first is what does not show
    if not len(parts):
        return None
    areas = parts[:, cv2.CC_STAT_AREA]
    left, top, width, height, _ = parts[areas >= PART_SHARE * areas.max()].T
    right, bottom = left + width, top + height
    return int(left.min()), int(top.min()), int(right.max()), int(bottom.max())


def _cell(pictures: Sequence[UInt8[Tensor, "_ _ 3"]], title: str, count: str) -> Image.Image:
    """The first picture large, the others small in a column beside it."""
    cell = Image.new("RGB", (CELL + GAP + SMALL, CELL + CAPTION), PAPER)
    places = [(0, 0), *((CELL + GAP, number * (SMALL + GAP)) for number in range(VIEWS - 1))]
    draw = ImageDraw.Draw(cell)
    for place, side in zip(places, (CELL, *[SMALL] * (VIEWS - 1)), strict=True):
        draw.rectangle((*place, place[0] + side - 1, place[1] + side - 1), CARD)
    for place, picture in zip(places, pictures, strict=False):
        cell.paste(Image.fromarray(picture.numpy()), place)
    draw.text((2, CELL + 6), title, INK, ImageFont.load_default(TITLE_SIZE))
    draw.text((2, CELL + 35), count, FAINT_INK, ImageFont.load_default(COUNT_SIZE))
    return cell


def _grid(cells: Sequence[Image.Image]) -> Image.Image:
    lines = math.ceil(len(cells) / max(MAX_COLUMNS, math.sqrt(len(cells))))
    columns = math.ceil(len(cells) / lines)
    width, height = cells[0].width + MARGIN, cells[0].height + MARGIN
    sheet = Image.new("RGB", (columns * width + MARGIN, lines * height + MARGIN), PAPER)
    for number, cell in enumerate(cells):
        line, column = divmod(number, columns)
        sheet.paste(cell, (MARGIN + column * width, MARGIN + line * height))
    return sheet
