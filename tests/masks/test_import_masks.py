from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.label_maps import write_label_map
from stylesplat.masks.import_masks import import_label_maps

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
    labels = 3 * LARGE.long() + 70_000 * SMALL.long()  # three bytes
    write_label_map(labels, tmp_path / "Annotations" / "video" / "002.png")
    found = import_label_maps(tmp_path, NAMES)
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
    found = import_label_maps(tmp_path, NAMES)
    assert found.maps.keys() == {"001.png", "003.png"}
    expected = torch.where(SMALL, second, torch.where(LARGE, first, 0))
    assert torch.equal(found.maps["001.png"].read(), expected)


def test_masks_of_another_capture(tmp_path: Path):
    write_label_map(LARGE.long(), tmp_path / "IMG_1.png")
    with pytest.raises(StyleSplatError, match=r"belongs to a photo of this capture.*001\.png"):
        import_label_maps(tmp_path, NAMES)
    with pytest.raises(StyleSplatError, match=r"no folder or \.json file"):
        import_label_maps(tmp_path / "none", NAMES)


def test_two_kinds_of_pictures(tmp_path: Path):
    for kind in ("ids", "shown"):
        write_label_map(3 * LARGE.long() + SMALL.long(), tmp_path / kind / "001.png")
    with pytest.raises(StyleSplatError, match="Give the folder of one kind"):
        import_label_maps(tmp_path, NAMES)


TWO_CAMERAS = ("cam0/001.jpg", "cam1/001.jpg", "cam1/002.jpg")


def maps_of(folder: Path, names: tuple[str, ...]) -> dict[str, list[int]]:
    """The ids by photo."""
    maps = import_label_maps(folder, names).maps
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
    found = import_label_maps(tmp_path, TWO_CAMERAS)
    assert found.names == {1: "pot", 2: "vase"}
    expected = {"cam0/001.jpg": [0, 1], "cam1/001.jpg": [0, 1], "cam1/002.jpg": [0, 2]}
    assert maps_of(tmp_path, TWO_CAMERAS) == expected


def test_bare_names_tell_where_only_one_photo_has_them(tmp_path: Path):
    write_label_map(LARGE.long(), tmp_path / "002.png")
    assert maps_of(tmp_path, TWO_CAMERAS) == {"cam1/002.jpg": [0, 1]}
    write_label_map(3 * LARGE.long() + SMALL.long(), tmp_path / "001.png")
    with pytest.raises(StyleSplatError, match=r"001 may be of cam0/001\.jpg or of cam1/001\.jpg"):
        import_label_maps(tmp_path, TWO_CAMERAS)


def test_a_photo_that_was_not_posed_lends_its_mask_to_no_other(tmp_path: Path):
    write_label_map(LARGE.long(), tmp_path / "cam0" / "002.png")
    write_label_map(LARGE.long(), tmp_path / "cam0" / "001.png")
    assert maps_of(tmp_path, TWO_CAMERAS) == {"cam0/001.jpg": [0, 1]}
    write_label_map(2 * LARGE.long(), tmp_path / "001.png")
    assert maps_of(tmp_path, ("cam0/001.jpg", "001.jpg"))["001.jpg"] == [0, 2], "needed by nobody"
