"""A grid of captioned pictures, with what its rows are at the left edge."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.figures.object_sheet import CELL, COUNT_SIZE, INK, MARGIN, PAPER, TITLE_SIZE

HEAD = CELL // 2  # pixels of width for a row's label and small pictures
CAPTION = TITLE_SIZE + 12  # pixels of height below a picture
LABEL = COUNT_SIZE + 9  # pixels of height above the small pictures

Picture = UInt8[Tensor, "_ _ 3"]


@dataclass(frozen=True)
class Row:
    """A row of a grid."""

    cells: Sequence[tuple[Picture, str] | None]
    """Pictures with their captions, squares of one size in the whole grid; None leaves a gap."""
    label: str = ""
    """What the row is, at its left."""
    pictures: Sequence[Picture] = ()
    """Shown small below the label, whole and of any size."""


def draw_grid(rows: Sequence[Row]) -> UInt8[Tensor, "H W 3"]:
    """Draw pictures in rows and columns. Texts too long for their place end in an ellipsis."""
    columns = max(len(row.cells) for row in rows)
    side = next(cell[0].shape[1] for row in rows for cell in row.cells if cell)
    head = HEAD + MARGIN if any(row.label or row.pictures for row in rows) else 0
    width, height = side + MARGIN, side + CAPTION + MARGIN
    sheet = Image.new("RGB", (head + columns * width + MARGIN, len(rows) * height + MARGIN), PAPER)
    for number, row in enumerate(rows):
        top = MARGIN + number * height
        _draw_head(sheet, row, top, side)
        for column, cell in enumerate(row.cells):
            if cell is not None:
                left = head + MARGIN + column * width
                sheet.paste(Image.fromarray(cell[0].cpu().numpy()), (left, top))
                write_line(sheet, (left + 2, top + side + 4), cell[1], TITLE_SIZE, side - 2)
    return torch.from_numpy(np.array(sheet))


def write_line(
    sheet: Image.Image, place: tuple[int, int], text: str, size: int, width: int
) -> None:
    """Draw one line of text that is at most so wide."""
    font = ImageFont.load_default(size)
    shown = text
    while shown and font.getlength(shown) > width:
        text = text[:-1]
        shown = text + "…"
    ImageDraw.Draw(sheet).text(place, shown, INK, font)


def _draw_head(sheet: Image.Image, row: Row, top: int, side: int) -> None:
    write_line(sheet, (MARGIN, top), row.label, COUNT_SIZE, HEAD)
    top += LABEL if row.label else 0
    room = (side - LABEL) // max(1, len(row.pictures))  # pixels of height for each
    for picture in row.pictures:
        small = Image.fromarray(picture.cpu().numpy())
        small.thumbnail((HEAD, room - 4))
        sheet.paste(small, (MARGIN, top))
        top += small.height + 4
