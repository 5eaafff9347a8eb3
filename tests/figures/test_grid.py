import torch

from stylesplat.figures.grid import CAPTION, CELL, HEAD, LABEL, MARGIN, PAPER, Row, draw_grid

EDGE = HEAD + MARGIN  # where the first column's margin begins if rows are labelled


def plain(*color: int, width: int = CELL, height: int = CELL) -> torch.Tensor:
    return torch.tensor(color, dtype=torch.uint8).expand(height, width, 3).clone()


def drawn(sheet: torch.Tensor) -> torch.Tensor:
    """The pixels that are not paper."""
    return (sheet != torch.tensor(PAPER)).any(dim=-1)


def test_pictures_stand_in_their_row_and_column():
    red, green, blue = plain(255, 0, 0), plain(0, 255, 0), plain(0, 0, 255)
    sheet = draw_grid([Row([(red, "a"), (green, "")], "one"), Row([None, (blue, "b")], "two")])
    height, width = CELL + CAPTION + MARGIN, CELL + MARGIN
    assert sheet.shape == (MARGIN + 2 * height, EDGE + MARGIN + 2 * width, 3)
    for picture, row, column in ((red, 0, 0), (green, 0, 1), (blue, 1, 1)):
        top, left = MARGIN + row * height, EDGE + MARGIN + column * width
        assert torch.equal(sheet[top : top + CELL, left : left + CELL], picture)
    gap = sheet[MARGIN + height :, EDGE + MARGIN : EDGE + MARGIN + CELL]
    assert not drawn(gap).any()
    wide, high = plain(9, 0, 0, width=60, height=20), plain(0, 9, 0, width=30, height=50)
    sheet = draw_grid([Row([(wide, ""), (high, "")]), Row([(high, "")])])
    assert sheet.shape == (2 * 50 + 3 * MARGIN, 60 + 30 + 3 * MARGIN, 3), "as large as the largest"


def test_long_texts_stay_in_their_place():
    black = plain(0, 0, 0)
    sheet = draw_grid([Row([(black, "M" * 99), (black, "")], "W" * 99)])
    mask = drawn(sheet)
    assert mask[MARGIN : MARGIN + LABEL, MARGIN : MARGIN + HEAD].any()
    assert not mask[:, MARGIN + HEAD : EDGE + MARGIN].any()
    left = EDGE + MARGIN + CELL
    assert mask[MARGIN + CELL :, left - 40 : left].any()
    assert not mask[:, left : left + MARGIN].any()
