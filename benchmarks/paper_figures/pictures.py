"""A figure's pictures, put together in one: side by side, or in rows and columns."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from stylesplat.figures.grid import Row, draw_grid

HEIGHT = 195  # pixels of a strip
GAP = 4  # pixels between its pictures


def strip(files: Sequence[Path]) -> Image.Image:
    """Pictures beside each other, each as high as the others."""
    images = [Image.open(file).convert("RGB") for file in files]
    height = min(HEIGHT, *(image.height for image in images), 10**6)
    small = [image.resize((round(image.width * height / image.height), height)) for image in images]
    joined = Image.new("RGB", (sum(i.width + GAP for i in small) - GAP, height), "white")
    left = 0
    for image in small:
        joined.paste(image, (left, 0))
        left += image.width + GAP
    return joined


def grid(rows: Mapping[str, Mapping[str, Path]]) -> Tensor:
    """Square pictures by row and caption, with both written beside them."""
    drawn = [
        Row([(picture(path), caption) for caption, path in cells.items()], label)
        for label, cells in rows.items()
    ]
    return draw_grid(drawn)


def picture(file: Path) -> Tensor:
    """A file's bytes of colour."""
    return torch.from_numpy(np.array(Image.open(file).convert("RGB")))
