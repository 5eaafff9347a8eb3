from pathlib import Path

import pytest
import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import Photo
from stylesplat.io.label_maps import (
    LABEL_MAPS_NAMES,
    fitted_maps,
    match_label_maps,
    read_label_map,
    read_names,
    write_label_map,
)

SMALL = Lens("PINHOLE", 8, 6, (9.0, 9.0, 4.0, 3.0))


def photo(lens: Lens, size: tuple[int, int] | None = None) -> Photo:
    return Photo(Path("unused.png"), True, lens, size or lens.pinhole().size)


def random_ids(limit: int, size: tuple[int, int] = (8, 6)) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    ids = torch.randint(0, limit, size[::-1], generator=generator)
    ids[0, 0] = limit - 1
    return ids


@pytest.mark.parametrize(
    ("limit", "mode"), [(2**8, "L"), (2**8 + 1, "I;16"), (2**16, "I;16"), (2**24, "RGB")]
)
def test_round_trip_in_the_smallest_form(tmp_path: Path, limit: int, mode: str):
    ids = random_ids(limit)
    write_label_map(ids, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == mode
    assert torch.equal(read_label_map(tmp_path / "a.png").long(), ids)
    palette = Image.frombytes("P", (2, 1), b"\2\0")
    palette.putpalette([255, 0, 0, 0, 255, 0, 0, 0, 255])
    palette.save(tmp_path / "a.png")
    assert read_label_map(tmp_path / "a.png").tolist() == [[2, 0]], "the index counts"


def test_what_is_no_id(tmp_path: Path):
    for bad in (-1, 2**24):
        with pytest.raises(StyleSplatError, match="label ids go from 0 to 16777215"):
            write_label_map(torch.tensor([[0, bad]]), tmp_path / "a.png")
    assert not any(tmp_path.iterdir())
    for mode, name, kind in (("L", "a.jpg", "JPEG"), ("LA", "a.png", "PNG")):
        Image.new(mode, (8, 6)).save(tmp_path / name)
        with pytest.raises(StyleSplatError, match=f"{kind} pixels of type {mode} cannot be label"):
            read_label_map(tmp_path / name)


def test_maps_are_matched_by_stem(tmp_path: Path):
    for name, label in (("a", 1), ("sub/b", 2), ("c.jpg", 3), ("other", 9)):
        write_label_map(torch.full((6, 8), label), tmp_path / f"{name}.png")
    names = ["sub/b.jpg", "missing.jpg", "c.jpg", "a.JPG"]
    maps = fitted_maps(match_label_maps(tmp_path, names), names, [photo(SMALL)] * 4)
    assert [None if m is None else int(m[0, 0]) for m in maps] == [2, None, 3, 1]


@pytest.mark.parametrize("size", [(4, 3), (16, 12), (2, 2)], ids=str)
def test_sizes_are_fitted_without_making_new_ids(tmp_path: Path, size: tuple[int, int]):
    ids = random_ids(2**24, size)
    write_label_map(ids, tmp_path / "a.png")
    found = match_label_maps(tmp_path, ["a.jpg"])
    (labels,) = fitted_maps(found, ["a.jpg"], [photo(SMALL)])
    assert labels is not None and labels.shape == (6, 8)
    assert set(labels.flatten().tolist()) <= set(ids.flatten().tolist())


@pytest.mark.parametrize(
    ("folder", "name", "match"),
    [
        (".", "b.png", r"None of the 1 label maps .* Name them like a\.png"),
        ("none", "b.png", r"no folder .*none with label maps.*--masks"),
        (".", "a.txt", r"no label maps in .*: it holds no pictures"),
        (".", "a.png", r"a\.png is 6x8, .* its photo \(8x6\)"),
    ],
)
def test_maps_of_no_photo(tmp_path: Path, folder: str, name: str, match: str):
    write_label_map(random_ids(9, (6, 8)), tmp_path / name)
    with pytest.raises(StyleSplatError, match=match):
        fitted_maps(match_label_maps(tmp_path / folder, ["a.jpg"]), ["a.jpg"], [photo(SMALL)])


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ('{"3": "va', "not valid JSON"),
        ('{"vase": "3"}', "expected names by label id.* Mend or delete it"),
    ],
)
def test_names_that_are_damaged(tmp_path: Path, content: str, expected: str):
    (tmp_path / LABEL_MAPS_NAMES).write_text(content)
    with pytest.raises(StyleSplatError, match=rf"Cannot read .*names\.json: .*{expected}"):
        read_names(tmp_path)
