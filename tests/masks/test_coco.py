"""COCO annotations and their run lengths."""

import json
from pathlib import Path

import pytest
import torch

from scenes import rand
from stylesplat.errors import StyleSplatError
from stylesplat.masks.import_masks import decode_rle, import_label_maps

NAMES = ("001.png", "002.png", "003.png")
SHAPE = (6, 8)
LARGE, SMALL = torch.zeros(2, *SHAPE, dtype=torch.bool)
LARGE[1:5, 1:7], SMALL[2:3, 2:5] = True, True
SMOOTH = rand(1, 200, 300)
SMOOTH = torch.nn.functional.avg_pool2d(SMOOTH, 9, 1)[0] > 0.5
HUGE = 2**62


def runs(mask: torch.Tensor) -> list[int]:
    """COCO's run lengths: down the columns, zeros first."""
    flat = mask.T.flatten().int()
    edges = (torch.diff(flat, prepend=torch.zeros(1, dtype=torch.int)) != 0).nonzero()[:, 0]
    return torch.diff(edges, prepend=torch.tensor([0]), append=torch.tensor([len(flat)])).tolist()


def packed(counts: list[int]) -> str:
    """COCO's string, as its description says: 5 bits a letter, low ones first."""
    text = ""
    for place, count in enumerate(counts):
        value = count - counts[place - 2] if place > 2 else count
        while True:
            group, value = value & 0x1F, value >> 5
            more = value != (-1 if group & 0x10 else 0)
            text += chr(48 + (group | (0x20 if more else 0)))
            if not more:
                break
    return text


def coco(tmp_path: Path, *, add: dict | None = None, **changes: object) -> Path:
    """A file with one annotation, and with what is added to the top level."""
    rle = {"size": list(SHAPE), "counts": packed(runs(LARGE))}
    annotation = {"image_id": 5, "category_id": 9, "segmentation": rle} | changes
    images = [{"id": 5, "file_name": "photos/002.jpg"}, {"id": 6, "file_name": "other.jpg"}]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"images": images, "annotations": [annotation]} | (add or {})))
    return path


@pytest.mark.parametrize("mask", [LARGE, SMALL, ~SMALL, LARGE & False, SMOOTH])
def test_run_lengths(mask: torch.Tensor):
    for counts in (runs(mask), packed(runs(mask))):
        found = decode_rle({"size": list(mask.shape), "counts": counts}, Path("a.json"))
        assert torch.equal(found, mask)


@pytest.mark.parametrize(
    "rle",
    [
        {"size": [2, 2], "counts": [HUGE, HUGE, HUGE, HUGE, 4]},  # 4 in 64 bits
        {"size": [2, 2], "counts": packed([HUGE, HUGE, HUGE, HUGE, 4])},
        {"size": [2, 2], "counts": packed([5, 0, 0]) + "O"},  # ends with -1
        {"size": [2, 2], "counts": "o" * 10**6},  # one run of millions of bits
        {"size": [2, 2], "counts": "\ud800\xff~"},
        {"size": [2**14, 2**14], "counts": [2**28]},
        {"size": [1e400, 3], "counts": [6]},
        None,
    ],
    ids=range(8),
)
def test_run_lengths_that_are_none(rle: object):
    """The first wrote out of bounds: its runs were added up, and wrapped, in 64 bits."""
    with pytest.raises(StyleSplatError, match=r"Cannot read a mask in a\.json") as caught:
        decode_rle(rle, Path("a.json"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("id", [7, 7.0, "7"])
def test_an_object_is_a_track_or_else_a_category(id: object, tmp_path: Path):
    extra = {"licenses": [], "categories": [{"id": id, "name": "pot", "color": "#f00"}]}
    found = import_label_maps(coco(tmp_path, category_id=id, add=extra, iscrowd=1), NAMES)
    assert torch.equal(found.maps["002.png"].read(), 7 * LARGE.long())
    assert found.names == {7: "pot"}
    tracked = import_label_maps(coco(tmp_path, track_id=id, category_id=None), NAMES)
    assert torch.equal(tracked.maps["002.png"].read(), 7 * LARGE.long()) and not tracked.names


IMAGES = [{"id": 5, "file_name": "cam1/001.jpg"}, {"id": 6, "file_name": "001.jpg"}]
FOLDERS = ("cam0/001.jpg", "cam1/001.jpg", "cam1/002.jpg")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"category_id": 0}, "the id 0 is not within 1 to 16777215"),
        ({"category_id": 1.5}, "category_id"),
        ({"category_id": "1" * 99}, "category_id|is not within"),
        ({"category_id": [1]}, "category_id"),
        ({"image_id": 77}, "there is no image 77"),
        ({"segmentation": [[1, 2, 3, 4]]}, "Polygons are not understood"),
        ({"segmentation": {"size": [6, 8], "counts": [3, 4]}}, "do not hold the pixels of 6x8"),
        ({"segmentation": {"size": [10**9, 10**9], "counts": [3]}}, "Expected `int` <= "),
        ({"add": {"images": 5}}, "images"),
        ({"add": {"annotations": [{"image_id": 5, "segmentation": {}}]}}, "no category_id"),
    ],
    ids=str,
)
def test_annotations_that_are_damaged(tmp_path: Path, changes: dict, expected: str):
    with pytest.raises(StyleSplatError, match=expected) as caught:
        import_label_maps(coco(tmp_path, **changes), NAMES).maps["002.png"].read()
    assert "a.json" in str(caught.value)


def test_photos_in_folders_are_told_by_their_paths(tmp_path: Path):
    maps = import_label_maps(coco(tmp_path, add={"images": IMAGES}), FOLDERS).maps
    assert maps.keys() == {"cam1/001.jpg"}, "nothing is drawn on the other"
    with pytest.raises(StyleSplatError, match=r"001 may be of cam0/001\.jpg or of cam1"):
        import_label_maps(coco(tmp_path, image_id=6, add={"images": IMAGES}), FOLDERS)
