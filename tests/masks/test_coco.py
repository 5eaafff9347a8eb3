"""COCO annotations and their run lengths."""

import json
from pathlib import Path

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.json_files import MAX_JSON
from stylesplat.masks.coco import decode_rle
from stylesplat.masks.import_masks import import_label_maps

NAMES = ("001.png", "002.png", "003.png")
SHAPE = (6, 8)
LARGE, SMALL = torch.zeros(2, *SHAPE, dtype=torch.bool)
LARGE[1:5, 1:7], SMALL[2:3, 2:5] = True, True


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


@pytest.mark.parametrize("mask", [LARGE, SMALL, ~SMALL, LARGE & ~SMALL, LARGE & False])
def test_run_lengths(mask: torch.Tensor):
    counts = runs(mask)
    plain = {"size": list(SHAPE), "counts": counts}
    assert torch.equal(decode_rle(plain, Path("a.json")), mask)
    assert torch.equal(decode_rle({**plain, "counts": packed(counts)}, Path("a.json")), mask)


def test_run_lengths_of_a_large_mask():
    generator = torch.Generator().manual_seed(0)
    mask = (
        torch.nn.functional.avg_pool2d(torch.rand(1, 200, 300, generator=generator), 9, 1)[0] > 0.5
    )
    rle = {"size": list(mask.shape), "counts": packed(runs(mask))}
    assert torch.equal(decode_rle(rle, Path("a.json")), mask)


def coco(tmp_path: Path, **changes: object) -> Path:
    annotation = {
        "image_id": 5,
        "category_id": 9,
        "segmentation": {"size": list(SHAPE), "counts": packed(runs(LARGE))},
    }
    images = [{"id": 5, "file_name": "photos/002.jpg"}, {"id": 6, "file_name": "other.jpg"}]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"images": images, "annotations": [annotation | changes]}))
    return path


def test_coco(tmp_path: Path):
    found = import_label_maps(coco(tmp_path), NAMES)
    assert torch.equal(found.maps["002.png"].read(), 9 * LARGE.long())
    found = import_label_maps(coco(tmp_path, track_id=4), NAMES)
    assert torch.equal(found.maps["002.png"].read(), 4 * LARGE.long())


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"category_id": 0}, "the id 0 is not within 1 to 16777215"),
        ({"category_id": 2**24}, "the id 16777216 is not"),
        ({"image_id": 77}, "there is no image 77"),
        ({"segmentation": [[1, 2, 3, 4]]}, "Polygons are not understood"),
        (
            {"segmentation": {"size": [6, 8], "counts": [3, 4]}},
            "its runs do not hold the pixels of 6x8",
        ),
        ({"segmentation": {"size": [10**9, 10**9], "counts": [3]}}, "Expected `int` <= "),
    ],
)
def test_coco_that_is_damaged(tmp_path: Path, changes: dict, expected: str):
    with pytest.raises(StyleSplatError, match=expected):
        import_label_maps(coco(tmp_path, **changes), NAMES).maps["002.png"].read()


@pytest.mark.parametrize(
    ("size", "counts"), [([200_000, 200_000], [4 * 10**10]), ([2, 3], [1e30]), ([1e400, 3], [6])]
)
def test_masks_that_would_fill_the_memory(size: list, counts: list):
    with pytest.raises(StyleSplatError, match=r"Cannot read a mask in a\.json"):
        decode_rle({"size": size, "counts": counts}, Path("a.json"))


HUGE = 2**62


@pytest.mark.parametrize(
    "rle",
    [
        {"size": [2, 2], "counts": [HUGE, HUGE, HUGE, HUGE, 4]},  # 4 in 64 bits
        {"size": [2, 2], "counts": packed([HUGE, HUGE, HUGE, HUGE, 4])},
        {"size": [2, 2], "counts": packed([5, 0, 0]) + "O"},  # ends with -1
        {"size": [2, 2], "counts": [5, -1]},
        {"size": [2, 2], "counts": [[4]]},
        {"size": [2, 2], "counts": [4.0]},
        {"size": [2, 2], "counts": [True, True, True, True]},
        {"size": [2, 2], "counts": ["4"]},
        {"size": [2, 2], "counts": 4},
        {"size": [2, 2], "counts": ""},
        {"size": [2, 2], "counts": "o" * 10**6},  # one run of millions of bits
        {"size": [2, 2], "counts": "\ud800\xff~"},
        {"size": [-2, -2], "counts": [4]},
        {"size": [0, 5], "counts": []},
        {"size": ["2", 2], "counts": [4]},
        {"size": [2], "counts": [2]},
        {"size": [2**14, 2**14], "counts": [2**28]},
        {"size": [2, 2]},
        None,
    ],
    ids=range(19),
)
def test_run_lengths_that_are_none(rle: object):
    """The first wrote out of bounds: its runs were added up, and wrapped, in 64 bits."""
    with pytest.raises(StyleSplatError, match=r"Cannot read a mask in a\.json") as caught:
        decode_rle(rle, Path("a.json"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        {"images": 5},
        {"images": [{"id": None, "file_name": "002.jpg"}]},
        {"images": [{"id": 5, "file_name": 2}]},
        {"images": [{"id": 5, "file_name": "\ud800"}]},
        {"images": [{"id": [5], "file_name": "002.jpg"}]},
        {"annotations": [[]]},
        {"annotations": [{"image_id": {}, "category_id": 1, "segmentation": {}}]},
        {"annotations": [{"image_id": 5, "segmentation": {}}]},
        {"annotations": [{"image_id": 5, "category_id": 1.5, "segmentation": {}}]},
        {"annotations": [{"image_id": 5, "category_id": 10**400, "segmentation": {}}]},
        {"categories": {"id": 9}},
    ],
    ids=range(11),
)
def test_annotations_of_wrong_types(tmp_path: Path, content: dict):
    path = coco(tmp_path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **content}))
    with pytest.raises(StyleSplatError, match=r"a\.json"):
        import_label_maps(path, NAMES)


def test_masks_of_one_photo_that_differ_in_size(tmp_path: Path):
    path = coco(tmp_path)
    content = json.loads(path.read_text())
    other = {**content["annotations"][0], "segmentation": {"size": [2, 2], "counts": [4]}}
    content["annotations"].append(other)
    path.write_text(json.dumps(content))
    with pytest.raises(StyleSplatError, match="differ in size: 2x2 and 8x6"):
        import_label_maps(path, NAMES)


def test_tracks_without_categories(tmp_path: Path):
    path = coco(tmp_path, track_id=5)
    content = json.loads(path.read_text())
    for each in content["annotations"]:
        each["track_id"] = 5
        each.pop("category_id", None)
    path.write_text(json.dumps(content))
    found = import_label_maps(path, NAMES)
    assert set(found.maps["002.png"].read().unique().tolist()) <= {0, 5} and not found.names


def maps_of(path: Path, names: tuple[str, ...]) -> dict[str, list[int]]:
    """The ids by photo."""
    maps = import_label_maps(path, names).maps
    return {name: sorted(drawn.read().unique().tolist()) for name, drawn in maps.items()}


def test_coco_of_photos_in_folders(tmp_path: Path):
    cameras = ("cam0/001.jpg", "cam1/001.jpg", "cam1/002.jpg")
    path = coco(tmp_path)
    content = json.loads(path.read_text())
    content["images"] = [{"id": 5, "file_name": "cam1/001.jpg"}, {"id": 6, "file_name": "001.jpg"}]
    path.write_text(json.dumps(content))
    assert maps_of(path, cameras) == {"cam1/001.jpg": [0, 9]}, "nothing is drawn on the other"
    content["annotations"][0]["image_id"] = 6
    path.write_text(json.dumps(content))
    with pytest.raises(StyleSplatError, match=r"001 may be of cam0/001\.jpg or of cam1"):
        import_label_maps(path, cameras)


def test_what_other_programs_add_is_passed_over(tmp_path: Path):
    path = coco(
        tmp_path, id=1, iscrowd=1, area=24.5, bbox=[1, 1, 6, 4], attributes={"occluded": False}
    )
    content = json.loads(path.read_text())
    content |= {
        "info": {},
        "licenses": [],
        "categories": [{"id": 9, "name": "pot", "color": "#f00"}],
    }
    path.write_text(json.dumps(content))
    found = import_label_maps(path, NAMES)
    assert torch.equal(found.maps["002.png"].read(), 9 * LARGE.long())
    assert found.names == {9: "pot"}


def test_it_may_be_larger_than_a_file_of_a_scene(tmp_path: Path):
    path = coco(tmp_path)
    path.write_text(path.read_text() + " " * MAX_JSON)
    assert "002.png" in import_label_maps(path, NAMES).maps


@pytest.mark.parametrize("id", [7, 7.0, "7"])
def test_ids_as_other_programs_write_them(id: object, tmp_path: Path):
    found = import_label_maps(coco(tmp_path, category_id=id), NAMES)
    assert set(found.maps["002.png"].read().unique().tolist()) == {0, 7}
    tracked = import_label_maps(coco(tmp_path, track_id=id), NAMES)
    assert set(tracked.maps["002.png"].read().unique().tolist()) == {0, 7}


@pytest.mark.parametrize("id", [0, -1, 1.5, "x", "²", "1" * 99, 10**30, None, [1]])
def test_ids_that_are_none(id: object, tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"a\.json"):
        import_label_maps(coco(tmp_path, category_id=id), NAMES)
