from pathlib import Path

import numpy as np
import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.posed_files import read_points

COLORS = [(0, 0, 0), (51, 102, 255), (255, 255, 255)]


def write(path: Path, columns: dict[str, str], rows: list[tuple[float, ...]]) -> Path:
    """An ASCII PLY."""
    head = ["ply", "format ascii 1.0", f"element vertex {len(rows)}"]
    head += [f"property {kind} {name}" for name, kind in columns.items()]
    lines = [" ".join(map(str, row)) for row in rows]
    path.write_text("\n".join([*head, "end_header", *lines, ""]))
    return path


@pytest.mark.parametrize(
    ("names", "kind", "factor"),
    [
        (("red", "green", "blue"), "uchar", 1),
        (("red", "green", "blue"), "float", 1 / 255),
        (("red", "green", "blue"), "double", 1),
        (("red", "green", "blue"), "ushort", 257),
        (("diffuse_red", "diffuse_green", "diffuse_blue"), "uchar", 1),
        (("r", "g", "b"), "float", 1 / 255),
        (("Red", "Green", "Blue"), "int", 1),
    ],
)
def test_colors_in_many_forms(tmp_path: Path, names: tuple[str, ...], kind: str, factor: float):
    columns = dict.fromkeys("xyz", "double") | dict.fromkeys(names, kind)
    whole = kind[0] in "ui"
    numbers = [[round(factor * c) if whole else factor * c for c in color] for color in COLORS]
    rows = [(i, 500_000.123, -1, *color) for i, color in enumerate(numbers)]
    means, colors = read_points(write(tmp_path / "points.ply", columns, rows))
    assert means is not None and means[2].tolist() == [2, 500_000.123, -1]
    assert colors is not None and colors.tolist() == [[*color] for color in COLORS]


def test_colors_of_a_splat(tmp_path: Path):
    columns = dict.fromkeys("xyz", "float") | {f"f_dc_{i}": "float" for i in range(3)}
    _, colors = read_points(write(tmp_path / "p.ply", columns, [(0, 0, 0, 0, 1, -99)]))
    assert colors is not None and colors.tolist() == [[128, 199, 0]]


def test_points_without_colors_are_grey(tmp_path: Path, said: list[str]):
    path = write(tmp_path / "p.ply", dict.fromkeys("xyz", "float"), [(1, 2, 3)])
    _, colors = read_points(path)
    assert colors is not None and colors.tolist() == [[128] * 3]
    assert "no colours" in said[0]


def test_points_that_are_no_numbers_are_left_out(tmp_path: Path, said: list[str]):
    columns = dict.fromkeys("xyz", "float") | dict.fromkeys(("r", "g", "b"), "uchar")
    rows = [(np.nan, 0, 0, 1, 1, 1), (1, 2, 3, 9, 8, 7), (0, np.inf, 0, 1, 1, 1)]
    means, colors = read_points(write(tmp_path / "p.ply", columns, rows))
    assert means is not None and torch.equal(means, torch.tensor([[1.0, 2, 3]]).double())
    assert colors is not None and colors.tolist() == [[9, 8, 7]]
    assert "2 of the 3 points" in said[0]


def test_points_without_a_coordinate(tmp_path: Path):
    path = write(tmp_path / "p.ply", {"x": "float", "y": "float"}, [(1, 2)])
    with pytest.raises(StyleSplatError, match=r"p\.ply have no column z"):
        read_points(path)
