"""Captures whose photos and poses do not go together wholly: what there is of both is taken."""

from collections.abc import Callable
from pathlib import Path

import pytest

from capture_files import save_noise
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.json_yaml import write_json

MakeCapture = Callable[..., Path]
SEVEN = tuple(f"{number:03d}.png" for number in range(1, 8))


@pytest.fixture(params=["colmap", "transforms", "transforms without sizes"])
def folder(request: pytest.FixtureRequest, make_capture: MakeCapture, tmp_path: Path) -> Path:
    """Seven posed photos."""
    if request.param == "colmap":
        return make_capture(count=7)
    out = tmp_path / "nerf"
    frames = []
    for row, name in enumerate(SEVEN):
        save_noise(out / "images" / name, seed=row)
        pose = [[1, 0, 0, row], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        frames.append({"file_path": f"images/{name}", "transform_matrix": pose})
    size = {} if "without" in request.param else {"w": 64, "h": 48}
    write_json({"fl_x": 60.0, **size, "frames": frames}, out / "transforms.json")
    return out


def lose(folder: Path, *names: str) -> None:
    for name in names:
        (folder / "images" / name).unlink()


def test_those_that_are_there_are_taken(folder: Path, said: list[str]):
    whole = load(folder)
    assert not said
    lose(folder, "002.png", "004.png")
    capture = load(folder)
    rows = [0, 2, 4, 5, 6]
    assert capture.cameras.names == tuple(SEVEN[row] for row in rows)
    assert capture.cameras.viewmats.equal(whole.cameras.viewmats[rows])
    assert all(capture.photos[i].equal(whole.photos[row]) for i, row in enumerate(rows))
    (line,) = said
    assert line.startswith("Missing, so left out: 002.png, 004.png (2 of the 7 photos that have")
    assert str(folder) in line


def test_fewer_than_half_are_refused(folder: Path):
    lose(folder, *SEVEN[:4])
    with pytest.raises(StyleSplatError, match=r"Only 3 of the 7 .*001.*and 1 more\. Put them back"):
        load(folder)


def test_photos_without_poses_are_told(folder: Path, said: list[str]):
    for name in ("a.jpg", "b/c.png"):
        save_noise(folder / "images" / name)
    lose(folder, "001.png")
    assert len(load(folder)) == 6
    assert said[0] == (
        f"Without a pose, so left out: a.jpg, b/c.png (2 of the 9 photos in {folder})."
    )
