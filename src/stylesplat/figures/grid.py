"""The grid of captioned pictures, which every sheet of the package is."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

GRID_CELL = 256  # pixels along a square cell of a sheet
GRID_HEAD = GRID_CELL // 2  # pixels of width for the label and the small pictures of a row
GRID_MARGIN = 16  # pixels around every picture
TITLE_SIZE, NOTE_SIZE = 22, 15  # pixels of text
CAPTION = TITLE_SIZE + 12  # pixels of height below a picture, for a line of `TITLE_SIZE`
LABEL = NOTE_SIZE + 9  # pixels of height above the small pictures
LETTERS = 40  # wider pictures have larger captions: text heights along the width
PAPER, CARD = (250, 250, 248), (226, 228, 230)
INK, FAINT_INK = (25, 25, 28), (105, 105, 112)

GridPicture = UInt8[Tensor, "_ _ 3"]
GridCell = tuple[GridPicture, str] | None
"""A picture with its caption, of which a second line is small; None is a gap."""


@dataclass(frozen=True)
class Row:
    cells: Sequence[GridCell]
    label: str = ""
    pictures: Sequence[GridPicture] = ()
    """Pictures of any size, drawn small below the label."""


def draw_grid(rows: Sequence[Row]) -> UInt8[Tensor, "H W 3"]:
    """Draw pictures of any size in rows and columns.

    Rows are as high, and columns as wide, as their largest picture. Text that is wider than its
    place ends in an ellipsis.
    """
    cells = [[cell and _captioned(*cell) for cell in row.cells] for row in rows]
    heights = [max(image.height for image in images if image) for images in cells]
    widths = [
        max((image.width for image in images if image), default=0) for images in zip_longest(*cells)
    ]
    head = GRID_HEAD + GRID_MARGIN if any(row.label or row.pictures for row in rows) else 0
    width, height = (sum(sides) + GRID_MARGIN * (1 + len(sides)) for sides in (widths, heights))
    sheet = Image.new("RGB", (head + width, height), PAPER)
    top = GRID_MARGIN
    for row, images, high in zip(rows, cells, heights, strict=True):
        _draw_head(sheet, row, top, high)
        left = head + GRID_MARGIN
        for image, wide in zip(images, widths, strict=False):
            if image:
                sheet.paste(image, (left, top))
            left += wide + GRID_MARGIN
        top += high + GRID_MARGIN
    return torch.from_numpy(np.array(sheet))


def wrap_cells(cells: Sequence[GridCell], columns: int) -> list[Row]:
    return [Row(cells[first : first + columns]) for first in range(0, len(cells), columns)]


def add_legend(
    sheet: UInt8[Tensor, "_ W 3"], names: Sequence[tuple[str, Sequence[int]]]
) -> UInt8[Tensor, "H W 3"]:
    """Draw names beside patches of their colours below a grid, in as many lines as needed."""
    font, line = ImageFont.load_default(TITLE_SIZE), TITLE_SIZE + 10
    right = sheet.shape[1] - GRID_MARGIN
    places, x, y = [], GRID_MARGIN, sheet.shape[0]
    for name, color in names:
        wide = round(font.getlength(name)) + 2 * line
        if x > GRID_MARGIN and x + wide > right:
            x, y = GRID_MARGIN, y + line
        places.append((name, tuple(color), x, y))
        x += wide
    page = Image.new("RGB", (sheet.shape[1], y + line + GRID_MARGIN), PAPER)
    page.paste(Image.fromarray(sheet.numpy()))
    draw = ImageDraw.Draw(page)
    for name, color, x, y in places:
        draw.rectangle((x, y + 2, x + TITLE_SIZE, y + 2 + TITLE_SIZE), color)
        draw.text((x + TITLE_SIZE + 6, y), name, INK, font)
    return torch.from_numpy(np.array(page))


def _captioned(picture: GridPicture, text: str) -> Image.Image:
    title, line, note = text.partition("\n")
    height, width, _ = picture.shape
    size = max(TITLE_SIZE, width // LETTERS)
    below = (size + CAPTION - TITLE_SIZE if text else 0) + (NOTE_SIZE + 9 if line else 0)
    cell = Image.new("RGB", (width, height + below), PAPER)
    cell.paste(Image.fromarray(picture.cpu().numpy()))
    _write_line(cell, (2, height + 4), title, size, width - 2, INK)
    _write_line(cell, (2, height + size + 13), note, NOTE_SIZE, width - 2, FAINT_INK)
    return cell


def _write_line(
    sheet: Image.Image,
    place: tuple[int, int],
    text: str,
    size: int,
    room: int,
    color: tuple[int, int, int],
) -> None:
    font = ImageFont.load_default(size)
    shown = text
    while shown and font.getlength(shown) > room:
        text = text[:-1]
        shown = text + "…"
    ImageDraw.Draw(sheet).text(place, shown, color, font)


def _draw_head(sheet: Image.Image, row: Row, top: int, height: int) -> None:
    _write_line(sheet, (GRID_MARGIN, top), row.label, NOTE_SIZE, GRID_HEAD, INK)
    top += LABEL if row.label else 0
    room = (height - LABEL) // max(1, len(row.pictures))  # pixels of height for each
    for picture in row.pictures:
        small = Image.fromarray(picture.cpu().numpy())
        small.thumbnail((GRID_HEAD, room - 4))
        sheet.paste(small, (GRID_MARGIN, top))
        top += small.height + 4
