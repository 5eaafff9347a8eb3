"""The grid of captioned pictures, which every sheet of the package is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

CELL = 256  # pixels along a square cell of a sheet
HEAD = CELL // 2  # pixels of width for the label and the small pictures of a row
MARGIN = 16  # pixels around every picture
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
    filled = [[cell for cell in row.cells if cell is not None] for row in rows]
    heights = [max(picture.shape[0] for picture, _ in cells) for cells in filled]
    widths = [0] * max(len(row.cells) for row in rows)
    for row in rows:
        for column, cell in enumerate(row.cells):
            if cell is not None:
                widths[column] = max(widths[column], cell[0].shape[1])
    captions = [max(_caption_height(*cell) for cell in cells) for cells in filled]
    head = HEAD + MARGIN if any(row.label or row.pictures for row in rows) else 0
    width = head + MARGIN + sum(widths) + MARGIN * len(widths)
    height = MARGIN + sum(heights) + sum(captions) + MARGIN * len(rows)
    sheet = Image.new("RGB", (width, height), PAPER)
    top = MARGIN
    for row, high, caption in zip(rows, heights, captions, strict=True):
        _draw_head(sheet, row, top, high)
        left = head + MARGIN
        for cell, wide in zip(row.cells, widths, strict=False):
            if cell is not None:
                picture, text = cell
                sheet.paste(Image.fromarray(picture.cpu().numpy()), (left, top))
                title, _, note = text.partition("\n")
                place, size = (left + 2, top + picture.shape[0] + 4), _title_size(picture)
                room = picture.shape[1] - 2
                _write_line(sheet, place, title, size, room, INK)
                below = (place[0], place[1] + size + 9)
                _write_line(sheet, below, note, NOTE_SIZE, room, FAINT_INK)
            left += wide + MARGIN
        top += high + caption + MARGIN
    return torch.from_numpy(np.array(sheet))


def wrap_cells(cells: Sequence[GridCell], columns: int) -> list[Row]:
    return [Row(cells[first : first + columns]) for first in range(0, len(cells), columns)]


def add_legend(
    sheet: UInt8[Tensor, "_ W 3"], names: Sequence[tuple[str, Sequence[int]]]
) -> UInt8[Tensor, "H W 3"]:
    """Draw names beside patches of their colours below a grid, in as many lines as needed."""
    font, line = ImageFont.load_default(TITLE_SIZE), TITLE_SIZE + 10
    right = sheet.shape[1] - MARGIN
    places, x, y = [], MARGIN, sheet.shape[0]
    for name, color in names:
        wide = round(font.getlength(name)) + 2 * line
        if x > MARGIN and x + wide > right:
            x, y = MARGIN, y + line
        places.append((name, tuple(color), x, y))
        x += wide
    page = Image.new("RGB", (sheet.shape[1], y + line + MARGIN), PAPER)
    page.paste(Image.fromarray(sheet.numpy()))
    draw = ImageDraw.Draw(page)
    for name, color, x, y in places:
        draw.rectangle((x, y + 2, x + TITLE_SIZE, y + 2 + TITLE_SIZE), color)
        draw.text((x + TITLE_SIZE + 6, y), name, INK, font)
    return torch.from_numpy(np.array(page))


def _title_size(picture: GridPicture) -> int:
    return max(TITLE_SIZE, picture.shape[1] // LETTERS)


def _caption_height(picture: GridPicture, text: str) -> int:
    second = NOTE_SIZE + 9 if "\n" in text else 0
    return _title_size(picture) + CAPTION - TITLE_SIZE + second if text else 0


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
    _write_line(sheet, (MARGIN, top), row.label, NOTE_SIZE, HEAD, INK)
    top += LABEL if row.label else 0
    room = (height - LABEL) // max(1, len(row.pictures))  # pixels of height for each
    for picture in row.pictures:
        small = Image.fromarray(picture.cpu().numpy())
        small.thumbnail((HEAD, room - 4))
        sheet.paste(small, (MARGIN, top))
        top += small.height + 4
