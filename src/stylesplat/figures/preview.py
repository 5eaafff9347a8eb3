"""What label maps say, drawn over some of the photos."""

from collections.abc import Mapping

import cv2
import numpy as np
import torch
from jaxtyping import Int, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.figures.object_sheet import MARGIN, PAPER, TITLE_SIZE
from stylesplat.figures.pictures import label_colors
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import BACKGROUND, ids_of, resize_labels
from stylesplat.scene.sampling import evenly
from stylesplat.studio_app.thumbnails import INK

PHOTOS = 8
COLUMNS = 4
WIDTH, HEIGHT = 400, 300  # pixels of a photo at most
TINT = 0.55  # how much of an object's colour covers the photo
LINE = TITLE_SIZE + 10  # pixels of height for a line of names


def mask_preview(capture: Capture, names: Mapping[int, str]) -> UInt8[Tensor, "H W 3"]:
    """Draw label maps over photos from the first to the last, with what objects are called.

    Args:
        capture: Photos with label maps.
        names: By id; other objects are called by their id.
    """
    maps = capture.label_maps or []
    rows = [row for row in range(len(capture)) if maps[row] is not None]
    cells, ids = [], set[int]()
    for row in evenly(rows, PHOTOS):
        labels = maps[row]
        assert labels is not None
        ids |= ids_of(labels) - {BACKGROUND}
        cells.append(_tinted(capture.photos[row], labels))
    called = {id: names.get(id, str(id)) for id in sorted(ids)}
    return torch.from_numpy(np.array(_page(cells, called)))


def _tinted(photo: UInt8[Tensor, "H W 3"], labels: Int[Tensor, "H W"]) -> np.ndarray:
    """A photo at cell size, each object in its colour."""
    height, width, _ = photo.shape
    factor = min(WIDTH / width, HEIGHT / height, 1.0)
    size = max(1, round(width * factor)), max(1, round(height * factor))
    small = cv2.resize(photo.numpy(), size, interpolation=cv2.INTER_AREA).astype(np.float32)
    mapped = resize_labels(labels, size[::-1])
    colors = label_colors(mapped).numpy()
    shown = (mapped != BACKGROUND)[..., None].numpy()
    return np.where(shown, TINT * colors + (1 - TINT) * small, small).round().astype(np.uint8)


def _page(cells: list[np.ndarray], names: Mapping[int, str]) -> Image.Image:
    height, width = (max(cell.shape[axis] for cell in cells) + MARGIN for axis in (0, 1))
    columns = min(COLUMNS, len(cells))
    lines = -(-len(cells) // columns)
    legend = _legend(names, columns * width - MARGIN)
    page = Image.new("RGB", (columns * width + MARGIN, lines * height + 2 * MARGIN + legend.height))
    page.paste(PAPER, (0, 0, *page.size))
    for number, cell in enumerate(cells):
        line, column = divmod(number, columns)
        page.paste(Image.fromarray(cell), (MARGIN + column * width, MARGIN + line * height))
    page.paste(legend, (MARGIN, MARGIN + lines * height))
    return page


def _legend(names: Mapping[int, str], width: int) -> Image.Image:
    """Each object's colour and name, in as many lines as that takes."""
    font, places, x, y = ImageFont.load_default(TITLE_SIZE), [], 0, 0
    for id, name in names.items():
        wide = round(font.getlength(name)) + 2 * LINE
        if x and x + wide > width:
            x, y = 0, y + LINE
        places.append((id, name, x, y))
        x += wide
    legend = Image.new("RGB", (width, y + LINE), PAPER)
    draw = ImageDraw.Draw(legend)
    for id, name, x, y in places:
        color = label_colors(torch.tensor([[id]]))[0, 0].tolist()
        draw.rectangle((x, y + 2, x + TITLE_SIZE, y + 2 + TITLE_SIZE), tuple(color))
        draw.text((x + TITLE_SIZE + 6, y), name, INK, font)
    return legend
