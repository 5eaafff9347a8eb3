import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.label_maps import write_label_map
from stylesplat.masks.coco import decode_rle
from stylesplat.masks.foreign import foreign_label_maps, overlaid

NAMES = ("001.png", "002.png", "003.png")
SHAPE = (6, 8)


def blob(rows: slice, columns: slice) -> torch.Tensor:
    mask = torch.zeros(SHAPE, dtype=torch.bool)
    mask[rows, columns] = True
    return mask


LARGE, SMALL = blob(slice(1, 5), slice(1, 7)), blob(slice(2, 3), slice(2, 5))


def save_binary(mask: torch.Tensor, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(255 * mask.numpy().astype(np.uint8)).save(path)


def test_pictures_of_ids_in_a_sub_folder(tmp_path: Path):
    labels = 3 * LARGE.long() + 300 * SMALL.long()
    write_label_map(labels, tmp_path / "Annotations" / "video" / "002.png")
    found = foreign_label_maps(tmp_path, NAMES)
    assert found.maps.keys() == {"002.png"}
    assert torch.equal(found.maps["002.png"].read(), labels)


@pytest.mark.parametrize(("folders", "ids"), [(("pot", "vase"), (1, 2)), (("7", "30"), (7, 30))])
def test_a_folder_of_binary_masks_per_object(
    tmp_path: Path, folders: tuple[str, str], ids: tuple[int, int]
):
    for folder, mask in zip(folders, (LARGE, SMALL), strict=True):
        for stem in ("001", "003"):
            save_binary(mask, tmp_path / folder / f"{stem}.png")
    first, second = ids
    found = foreign_label_maps(tmp_path, NAMES)
    assert found.maps.keys() == {"001.png", "003.png"}
    expected = torch.where(SMALL, second, torch.where(LARGE, first, 0))
    assert torch.equal(found.maps["001.png"].read(), expected)


def test_the_smaller_mask_lies_on_top_in_either_order():
    one, other = overlaid([(1, LARGE), (2, SMALL)]), overlaid([(2, SMALL), (1, LARGE)])
    assert torch.equal(one, other)
    assert (one == 2).sum() == SMALL.sum()


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
    found = foreign_label_maps(coco(tmp_path), NAMES)
    assert torch.equal(found.maps["002.png"].read(), 9 * LARGE.long())
    found = foreign_label_maps(coco(tmp_path, track_id=4), NAMES)
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
        foreign_label_maps(coco(tmp_path, **changes), NAMES).maps["002.png"].read()


def test_masks_of_another_capture(tmp_path: Path):
    write_label_map(LARGE.long(), tmp_path / "IMG_1.png")
    with pytest.raises(StyleSplatError, match=r"belongs to a photo of this capture.*001\.png"):
        foreign_label_maps(tmp_path, NAMES)
    with pytest.raises(StyleSplatError, match=r"no folder or \.json file"):
        foreign_label_maps(tmp_path / "none", NAMES)


def test_ids_of_three_bytes(tmp_path: Path):
    """What `object_mask/` may hold, other programs' pictures may."""
    write_label_map(LARGE.long() * 70_000 + SMALL.long(), tmp_path / "001.png")
    labels = foreign_label_maps(tmp_path, NAMES).maps["001.png"].read()
    assert 70_001 in labels.unique().tolist()


def test_two_kinds_of_pictures(tmp_path: Path):
    for kind in ("ids", "shown"):
        write_label_map(3 * LARGE.long() + SMALL.long(), tmp_path / kind / "001.png")
    with pytest.raises(StyleSplatError, match="Give the folder of one kind"):
        foreign_label_maps(tmp_path, NAMES)


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
        foreign_label_maps(path, NAMES)


def test_masks_of_one_photo_that_differ_in_size(tmp_path: Path):
    path = coco(tmp_path)
    content = json.loads(path.read_text())
    other = {**content["annotations"][0], "segmentation": {"size": [2, 2], "counts": [4]}}
    content["annotations"].append(other)
    path.write_text(json.dumps(content))
    with pytest.raises(StyleSplatError, match="differ in size: 2x2 and 8x6"):
        foreign_label_maps(path, NAMES)


def test_tracks_without_categories(tmp_path: Path):
    path = coco(tmp_path, track_id=5)
    content = json.loads(path.read_text())
    for each in content["annotations"]:
        each["track_id"] = 5
        each.pop("category_id", None)
    path.write_text(json.dumps(content))
    found = foreign_label_maps(path, NAMES)
    assert set(found.maps["002.png"].read().unique().tolist()) <= {0, 5} and not found.names


TWO_CAMERAS = ("cam0/001.jpg", "cam1/001.jpg", "cam1/002.jpg")


def maps_of(folder: Path, names: tuple[str, ...]) -> dict[str, list[int]]:
    """The ids by photo."""
    maps = foreign_label_maps(folder, names).maps
    return {name: sorted(drawn.read().unique().tolist()) for name, drawn in maps.items()}


def test_photos_in_folders_are_told_by_their_paths(tmp_path: Path):
    for id, key in enumerate(("cam0/001", "cam1/001", "cam1/002"), start=1):
        labels = 9 * LARGE.long() + id * SMALL.long()
        write_label_map(labels, tmp_path / "deva" / "ids" / f"{key}.png")
        write_label_map(id * LARGE.long(), tmp_path / "one" / f"{key}.png")
    expected = {"cam0/001.jpg": [0, 9, 10], "cam1/001.jpg": [0, 9, 11], "cam1/002.jpg": [0, 9, 12]}
    assert maps_of(tmp_path / "deva", TWO_CAMERAS) == expected
    # Folders of photos are no objects, even of binary masks
    expected = {"cam0/001.jpg": [0, 1], "cam1/001.jpg": [0, 2], "cam1/002.jpg": [0, 3]}
    assert maps_of(tmp_path / "one", TWO_CAMERAS) == expected


def test_a_folder_of_binary_masks_per_object_with_the_folders_of_the_photos(tmp_path: Path):
    for key in ("pot/cam0/001", "pot/cam1/001", "vase/cam1/002"):
        save_binary(LARGE, tmp_path / f"{key}.png")
    found = foreign_label_maps(tmp_path, TWO_CAMERAS)
    assert found.names == {1: "pot", 2: "vase"}
    expected = {"cam0/001.jpg": [0, 1], "cam1/001.jpg": [0, 1], "cam1/002.jpg": [0, 2]}
    assert maps_of(tmp_path, TWO_CAMERAS) == expected


def test_bare_names_tell_where_only_one_photo_has_them(tmp_path: Path):
    write_label_map(LARGE.long(), tmp_path / "002.png")
    assert maps_of(tmp_path, TWO_CAMERAS) == {"cam1/002.jpg": [0, 1]}
    write_label_map(3 * LARGE.long() + SMALL.long(), tmp_path / "001.png")
    with pytest.raises(StyleSplatError, match=r"001 may be of cam0/001\.jpg or of cam1/001\.jpg"):
        foreign_label_maps(tmp_path, TWO_CAMERAS)


def test_names_that_could_be_many_do_no_harm_where_nobody_needs_them(tmp_path: Path):
    for id, key in enumerate(("001", "cam0/001", "cam1/001"), start=1):
        write_label_map(id * LARGE.long(), tmp_path / f"{key}.png")
    assert maps_of(tmp_path, TWO_CAMERAS) == {"cam0/001.jpg": [0, 2], "cam1/001.jpg": [0, 3]}
    assert maps_of(tmp_path, ("001.jpg", *TWO_CAMERAS))["001.jpg"] == [0, 1]


def test_a_photo_that_was_not_posed_lends_its_mask_to_no_other(tmp_path: Path):
    write_label_map(LARGE.long(), tmp_path / "cam0" / "002.png")
    write_label_map(LARGE.long(), tmp_path / "cam0" / "001.png")
    assert maps_of(tmp_path, TWO_CAMERAS) == {"cam0/001.jpg": [0, 1]}


def test_coco_of_photos_in_folders(tmp_path: Path):
    path = coco(tmp_path)
    content = json.loads(path.read_text())
    content["images"] = [{"id": 5, "file_name": "cam1/001.jpg"}, {"id": 6, "file_name": "001.jpg"}]
    path.write_text(json.dumps(content))
    assert maps_of(path, TWO_CAMERAS) == {"cam1/001.jpg": [0, 9]}, "nothing is drawn on the other"
    content["annotations"][0]["image_id"] = 6
    path.write_text(json.dumps(content))
    with pytest.raises(StyleSplatError, match=r"001 may be of cam0/001\.jpg or of cam1"):
        foreign_label_maps(path, TWO_CAMERAS)
