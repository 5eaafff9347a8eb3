"""Rendered views on disk: under the photos' names, whatever these are."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.images import read_image
from stylesplat.io.renders import png_names, refuse_taken, write_views

CLEAR = torch.full((4, 6, 4), 128, dtype=torch.uint8)


def pictures(count: int) -> list[torch.Tensor]:
    """Each of one colour, which is its number."""
    return [torch.full((4, 6, 3), number, dtype=torch.uint8) for number in range(count)]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["cam0/0001.jpg", "cam1/0001.jpg"], ["cam0/0001.png", "cam1/0001.png"]),
        (["a.jpg", "a.png"], ["a.jpg.png", "a.png.png"]),
        (["a", "a.b", "a.b.jpg"], ["a.png", "a.b.png", "a.b.jpg.png"]),
    ],
)
def test_every_view_has_a_file_of_its_own(names: list[str], expected: list[str], tmp_path: Path):
    write_views(names, pictures(len(names)), tmp_path / "views")
    found = sorted(path for path in (tmp_path / "views").rglob("*") if path.is_file())
    assert len(found) == len(names)
    assert png_names(names) == expected
    for number, name in enumerate(expected):
        assert (read_image(tmp_path / "views" / name) == number).all()


def test_what_is_there_stays_unless_told_otherwise(tmp_path: Path):
    (tmp_path / "views").mkdir()
    (tmp_path / "views" / "notes.txt").write_text("mine")
    for act in (
        lambda: refuse_taken(tmp_path / "views", overwrite=False),
        lambda: write_views(["a.jpg"], pictures(1), tmp_path / "views"),
    ):
        with pytest.raises(StyleSplatError, match="--overwrite"):
            act()
    refuse_taken(tmp_path / "views", overwrite=True)
    write_views(["a.jpg"], pictures(1), tmp_path / "views", overwrite=True)
    assert {path.name for path in (tmp_path / "views").iterdir()} == {"a.png", "notes.txt"}


@pytest.mark.parametrize("name", ["a.avi", "a.EXR", "a.glb"])
def test_no_folder_has_the_name_of_a_picture_or_video(name: str, tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"not among the formats\. Use \.mp4, .*folder"):
        refuse_taken(tmp_path / name, overwrite=False)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".JPEG", ".webp"])
def test_one_view_is_one_picture(suffix: str, tmp_path: Path):
    write_views(["cam0/a.jpg"], [pictures(200)[199]], tmp_path / f"view{suffix}")
    assert (read_image(tmp_path / f"view{suffix}") == 199).all()
    assert len([*tmp_path.iterdir()]) == 1
    with pytest.raises(StyleSplatError, match="exists"):
        refuse_taken(tmp_path / f"view{suffix}", overwrite=False)
    refuse_taken(tmp_path / f"view{suffix}", overwrite=True)


@pytest.mark.parametrize(("fps", "ticks"), [(None, 33), (8, 125)])
def test_several_views_are_an_animation(fps: int | None, ticks: int, tmp_path: Path):
    views = [CLEAR, torch.full((4, 6, 4), 255, dtype=torch.uint8)]
    write_views(["a", "b"], views, tmp_path / "a.webp", fps=fps)
    with Image.open(tmp_path / "a.webp") as image:
        assert getattr(image, "n_frames", 1) == 2 and image.info["loop"] == 0
        for row, alpha in enumerate((128, 255)):
            image.seek(row)
            assert image.convert("RGBA").getchannel("A").getextrema() == (alpha, alpha)
            assert abs(image.info["duration"] - ticks) <= 1


def never() -> Iterator[torch.Tensor]:
    raise AssertionError("nothing is rendered for this")
    yield


@pytest.mark.parametrize(
    ("names", "output", "fps", "match"),
    [
        (["a"], "views", 24, r"Leave --fps out, or name a video\."),
        (["a"], "a.png", 24, r"Leave --fps out, or name a video\."),
        ([], "a.png", None, r"there are 0 views\. Choose one with --view"),
        (["a", "b"], "a.png", None, r"there are 2 views\. Choose one with --view"),
    ],
)
def test_what_is_no_video(
    names: list[str], output: str, fps: int | None, match: str, tmp_path: Path
):
    with pytest.raises(StyleSplatError, match=match):
        write_views(names, never(), tmp_path / output, fps=fps)
    assert not any(tmp_path.iterdir())


def numbers(path: Path) -> np.ndarray:
    """As another library reads them."""
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def test_depths_are_numbers_in_their_files(tmp_path: Path):
    depths = torch.tensor([[0.0, 1.25, 1e-3], [7.5, 1234.567, 3.0]])
    write_views(["b/a.jpg"], [depths], tmp_path / "float")
    found = numbers(tmp_path / "float" / "b" / "a.tif")
    assert found.dtype == np.float32 and torch.equal(torch.from_numpy(found), depths)
    write_views(["a.jpg"], [depths], tmp_path / "a.tiff")
    assert (numbers(tmp_path / "a.tiff") == found).all()


DEPTHS = torch.rand(4, 6)
IDS = torch.zeros(4, 6, dtype=torch.int64)


@pytest.mark.parametrize(
    ("picture", "suffix", "match"),
    [
        (CLEAR, ".jpg", r"\.jpg has no transparency here\. Choose a --background"),
        (DEPTHS, ".png", r"Depths in world units go into \.tif files, not into \.png"),
        (IDS, ".jpg", r"Label ids go into \.png files, not into \.jpg"),
        (pictures(1)[0], ".tif", r"\.tif is for depth-float\. Write colours into a \.png"),
    ],
)
def test_pictures_that_a_file_cannot_hold(picture, suffix: str, match: str, tmp_path: Path):
    with pytest.raises(StyleSplatError, match=match):
        write_views(["a"], [picture], tmp_path / f"a{suffix}")
    assert not any(tmp_path.iterdir())
