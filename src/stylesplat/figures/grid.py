"""The grid of captioned pictures that every sheet of the package is."""

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
TITLE_SIZE, COUNT_SIZE = 22, 15  # pixels of text
CAPTION = TITLE_SIZE + 12  # pixels of height below a picture, for a line of `TITLE_SIZE`
LABEL = COUNT_SIZE + 9  # pixels of height above the small pictures
LETTERS = 40  # wider pictures have larger captions: text heights along the width
PAPER, CARD = (250, 250, 248), (226, 228, 230)
INK, FAINT_INK = (25, 25, 28), (105, 105, 112)

GridPicture = UInt8[Tensor, "_ _ 3"]


@dataclass(frozen=True)
class Row:
    """A row of a grid."""

    cells: Sequence[tuple[GridPicture, str] | None]
    """Pictures with their captions, of which a second line is small; None leaves a gap."""
    label: str = ""
    """Text at the left of the row."""
    pictures: Sequence[GridPicture] = ()
    """Pictures of any size, shown small below the label."""


def draw_grid(rows: Sequence[Row]) -> UInt8[Tensor, "H W 3"]:
    """Draw pictures of any size in rows and columns.

    Rows are as high, and columns as wide, as their largest picture. Text that is wider than its
    place ends in an ellipsis.
    """
    heights, captions, widths = _heights(rows), [*map(_caption_height, rows)], _widths(rows)
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
                sheet.paste(Image.fromarray(cell[0].cpu().numpy()), (left, top))
                _write_caption(sheet, cell, (left + 2, top + cell[0].shape[0] + 4))
            left += wide + MARGIN
        top += high + caption + MARGIN
    return torch.from_numpy(np.array(sheet))


def write_line(
    sheet: Image.Image,
    place: tuple[int, int],
    text: str,
    size: int,
    width: int,
    color: tuple[int, int, int] = INK,
) -> None:
    """Draw one line of text that is at most so wide."""
    font = ImageFont.load_default(size)
    shown = text
    while shown and font.getlength(shown) > width:
        text = text[:-1]
        shown = text + "…"
    ImageDraw.Draw(sheet).text(place, shown, color, font)


def in_lines(cells: Sequence[tuple[GridPicture, str] | None], columns: int) -> list[Row]:
    """Rows of so many cells each."""
    return [Row(cells[first : first + columns]) for first in range(0, len(cells), columns)]


def legend(names: Sequence[tuple[str, Sequence[int]]], width: int) -> UInt8[Tensor, "H W 3"]:
    """Draw names beside patches of their colours, in as many lines as fit the width."""
    font, line = ImageFont.load_default(TITLE_SIZE), TITLE_SIZE + 10
    places, x, y = [], 0, 0
    for name, color in names:
        wide = round(font.getlength(name)) + 2 * line
        if x and x + wide > width:
            x, y = 0, y + line
        places.append((name, tuple(color), x, y))
        x += wide
    page = Image.new("RGB", (width, y + line), PAPER)
    draw = ImageDraw.Draw(page)
    for name, color, x, y in places:
        draw.rectangle((x, y + 2, x + TITLE_SIZE, y + 2 + TITLE_SIZE), color)
        draw.text((x + TITLE_SIZE + 6, y), name, INK, font)
    return torch.from_numpy(np.array(page))


def stacked(upper: UInt8[Tensor, "_ W 3"], lower: UInt8[Tensor, "_ V 3"]) -> UInt8[Tensor, "H W 3"]:
    """A grid with a narrower picture, such as a legend, below it, and a margin below that."""
    width = upper.shape[1]
    below = torch.tensor(PAPER, dtype=torch.uint8).repeat(lower.shape[0] + MARGIN, width, 1)
    below[: lower.shape[0], MARGIN : MARGIN + lower.shape[1]] = lower
    return torch.cat([upper, below])


def _heights(rows: Sequence[Row]) -> list[int]:
    return [max(cell[0].shape[0] for cell in row.cells if cell is not None) for row in rows]


def _widths(rows: Sequence[Row]) -> list[int]:
    return [
        max(
            row.cells[column][0].shape[1]  # pyright: ignore[reportOptionalSubscript]
            for row in rows
            if column < len(row.cells) and row.cells[column] is not None
        )
        for column in range(max(len(row.cells) for row in rows))
    ]


def _text_size(picture: GridPicture) -> int:
    return max(TITLE_SIZE, picture.shape[1] // LETTERS)


def _caption_height(row: Row) -> int:
    """Pixels of height below the pictures of a row, which may have no captions."""
    texts = [(_text_size(cell[0]), cell[1]) for cell in row.cells if cell is not None]
    second = COUNT_SIZE + 9 if any("\n" in text for _, text in texts) else 0
    size = max((size for size, text in texts), default=0)
    return size + CAPTION - TITLE_SIZE + second if any(text for _, text in texts) else 0


def _write_caption(
    sheet: Image.Image, cell: tuple[GridPicture, str], place: tuple[int, int]
) -> None:
    picture, text = cell
    title, _, note = text.partition("\n")
    left, top = place
    width, size = picture.shape[1] - 2, _text_size(picture)
    write_line(sheet, place, title, size, width)
    write_line(sheet, (left, top + size + 9), note, COUNT_SIZE, width, FAINT_INK)


def _draw_head(sheet: Image.Image, row: Row, top: int, height: int) -> None:
    write_line(sheet, (MARGIN, top), row.label, COUNT_SIZE, HEAD)
    top += LABEL if row.label else 0
    room = (height - LABEL) // max(1, len(row.pictures))  # pixels of height for each
    for picture in row.pictures:
        small = Image.fromarray(picture.cpu().numpy())
        small.thumbnail((HEAD, room - 4))
        sheet.paste(small, (MARGIN, top))
        top += small.height + 4
