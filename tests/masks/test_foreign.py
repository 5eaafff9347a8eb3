import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.label_maps import read_label_map, write_label_map
from stylesplat.masks.foreign import decode_rle, foreign_label_maps, overlaid
from stylesplat.verbs.mask import import_masks
from tiny_captures import HEIGHT, WIDTH, write_capture

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
    assert torch.equal(found.maps["002.png"](), labels)


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
    assert torch.equal(found.maps["001.png"](), expected)


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
    assert torch.equal(found.maps["002.png"](), 9 * LARGE.long())
    found = foreign_label_maps(coco(tmp_path, track_id=4), NAMES)
    assert torch.equal(found.maps["002.png"](), 4 * LARGE.long())


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"category_id": 0}, "the id 0 is not within 1 to 16777215"),
        ({"category_id": 2**24}, "the id 16777216 is not"),
        ({"image_id": 77}, "KeyError"),
        ({"segmentation": [[1, 2, 3, 4]]}, "Polygons are not understood"),
        ({"segmentation": {"size": [6, 8], "counts": [3, 4]}}, "its runs hold 7 pixels of 6x8"),
        ({"segmentation": {"size": [10**9, 10**9], "counts": [3]}}, "its runs hold 3 pixels"),
    ],
)
def test_coco_that_is_damaged(tmp_path: Path, changes: dict, expected: str):
    with pytest.raises(StyleSplatError, match=expected):
        foreign_label_maps(coco(tmp_path, **changes), NAMES).maps["002.png"]()


def test_masks_of_another_capture(tmp_path: Path):
    write_label_map(LARGE.long(), tmp_path / "IMG_1.png")
    with pytest.raises(StyleSplatError, match=r"belongs to a photo of this capture.*001\.png"):
        foreign_label_maps(tmp_path, NAMES)
    with pytest.raises(StyleSplatError, match=r"no folder or \.json file"):
        foreign_label_maps(tmp_path / "none", NAMES)


def test_ids_of_three_bytes(tmp_path: Path):
    """What `object_mask/` may hold, other programs' pictures may."""
    write_label_map(LARGE.long() * 70_000 + SMALL.long(), tmp_path / "001.png")
    labels = foreign_label_maps(tmp_path, NAMES).maps["001.png"]()
    assert 70_001 in labels.unique().tolist()


def test_two_kinds_of_pictures(tmp_path: Path):
    for kind in ("ids", "shown"):
        write_label_map(3 * LARGE.long() + SMALL.long(), tmp_path / kind / "001.png")
    with pytest.raises(StyleSplatError, match="Give the folder of one kind"):
        foreign_label_maps(tmp_path, NAMES)


def test_a_capture_gets_its_label_maps(tmp_path: Path):
    capture = write_capture(tmp_path / "capture")
    mask = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    mask[5:20, 9:30] = True
    save_binary(mask, tmp_path / "masks" / "cup" / "001.png")
    save_binary(mask, tmp_path / "masks" / "cup" / "003.png")
    found = import_masks(capture, tmp_path / "masks")
    assert (found["photos"], found["of"], found["ids"]) == (2, 3, [1])
    assert torch.equal(read_label_map(capture / "object_mask" / "003.png") == 1, mask)
    with pytest.raises(StyleSplatError, match="--overwrite"):
        import_masks(capture, tmp_path / "masks")
    (capture / "object_mask/001.png").write_bytes(b"damaged")
    again = import_masks(capture, tmp_path / "masks", overwrite=True)
    assert again["ids"] == found["ids"]
    load(capture)  # they are whole again


def test_masks_of_another_shape_leave_nothing(tmp_path: Path):
    capture = write_capture(tmp_path / "capture")
    save_binary(LARGE, tmp_path / "masks" / "cup" / "001.png")
    save_binary(torch.ones(40, 9, dtype=torch.bool), tmp_path / "masks" / "cup" / "002.png")
    with pytest.raises(StyleSplatError, match="not the shape of its photo"):
        import_masks(capture, tmp_path / "masks")
    assert not (capture / "object_mask").exists()


@pytest.mark.parametrize(
    ("size", "counts"), [([200_000, 200_000], [4 * 10**10]), ([2, 3], [1e30]), ([1e400, 3], [6])]
)
def test_masks_that_would_fill_the_memory(size: list, counts: list):
    with pytest.raises(StyleSplatError, match=r"Cannot read a mask in a\.json"):
        decode_rle({"size": size, "counts": counts}, Path("a.json"))


def test_tracks_without_categories(tmp_path: Path):
    path = coco(tmp_path, track_id=5)
    content = json.loads(path.read_text())
    for each in content["annotations"]:
        each["track_id"] = 5
        each.pop("category_id", None)
    path.write_text(json.dumps(content))
    found = foreign_label_maps(path, NAMES)
    assert set(found.maps["002.png"]().unique().tolist()) <= {0, 5} and not found.names
