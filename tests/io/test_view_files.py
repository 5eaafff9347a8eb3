"""Rendered views on disk: under the photos' names, whatever these are."""

from pathlib import Path

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.photos import read_image
from stylesplat.io.label_maps import read_label_map
from stylesplat.io.view_files import png_names, refuse_taken, write_views


def pictures(count: int) -> list[torch.Tensor]:
    """Each of one colour, which is its number."""
    return [torch.full((4, 6, 3), number, dtype=torch.uint8) for number in range(count)]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["cam0/0001.jpg", "cam1/0001.jpg"], ["cam0/0001.png", "cam1/0001.png"]),
        (["a.jpg", "a.png"], ["a.jpg.png", "a.png.png"]),
        (["a.jpg", "a.png", "a.jpg.png"], ["a.jpg.png", "a.png.png", "a.jpg.png.png"]),
        (["a.jpg", "A.jpg"], ["a.png", "A.png"]),
        (["a.jpg", "b/a.jpg"], ["a.png", "b/a.png"]),
        (["a", "a.b", "a.b.jpg"], ["a.png", "a.b.png", "a.b.jpg.png"]),
        (["0001"], ["0001.png"]),
        (["a", "a.png"], ["a.png", "a.png.png"]),
    ],
)
def test_every_view_has_a_file_of_its_own(names: list[str], expected: list[str], tmp_path: Path):
    write_views(names, pictures(len(names)), tmp_path / "views")
    found = sorted(path for path in (tmp_path / "views").rglob("*") if path.is_file())
    assert len(found) == len(names)
    assert png_names(names) == expected
    for number, name in enumerate(expected):
        assert (read_image(tmp_path / "views" / name) == number).all()


@pytest.mark.parametrize("name", ["../a.jpg", "/a.jpg", "b/../../a.jpg", "."])
def test_views_stay_in_their_folder(name: str, tmp_path: Path):
    write_views([name], pictures(1), tmp_path / "deep" / "views")
    (found,) = (path for path in tmp_path.rglob("*") if path.is_file())
    assert found.is_relative_to(tmp_path / "deep" / "views") and found.suffix == ".png"


def test_label_ids_are_written_as_label_maps(tmp_path: Path):
    ids = torch.tensor([[0, 3], [70000, 7]])
    write_views(["cam0/1.jpg"], [ids], tmp_path / "views")
    assert torch.equal(read_label_map(tmp_path / "views" / "cam0" / "1.png").long(), ids)


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


def test_a_video_that_is_there(tmp_path: Path):
    (tmp_path / "a.MP4").write_bytes(b"mine")
    with pytest.raises(StyleSplatError, match="exists"):
        refuse_taken(tmp_path / "a.MP4", overwrite=False)
    refuse_taken(tmp_path / "a.MP4", overwrite=True)
    refuse_taken(tmp_path / "b.mp4", overwrite=False)
