from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.label_maps import write_label_map
from stylesplat.masks.import_masks import import_label_maps

NAMES = ("001.png", "002.png", "003.png")
TWO_CAMERAS = ("cam0/001.jpg", "cam1/001.jpg", "cam1/002.jpg")
LARGE, SMALL = torch.zeros(2, 6, 8, dtype=torch.bool)
LARGE[1:5, 1:7], SMALL[2:3, 2:5] = True, True
ONE, MANY = LARGE.long(), 3 * LARGE.long() + 70_000 * SMALL.long()  # ids of three bytes


def write(folder: Path, pictures: dict[str, Tensor]) -> Path:
    """Write pictures of ids, and black and white ones of masks."""
    for name, picture in pictures.items():
        path = folder / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        if picture.dtype == torch.bool:
            Image.fromarray(255 * picture.numpy().astype(np.uint8)).save(path)
        else:
            write_label_map(picture, path)
    return folder


def per_object(first: str, second: str) -> dict[str, Tensor]:
    """A folder of masks for each of two objects."""
    return {f"{first}/001": LARGE, f"{second}/001": SMALL, f"{first}/003": LARGE}


@pytest.mark.parametrize(
    ("photos", "pictures", "expected"),
    [
        (NAMES, {"Annotations/video/002": MANY}, {"002.png": MANY}),
        (NAMES, per_object("pot", "vase"), {"001.png": ONE + SMALL, "003.png": ONE}),
        (NAMES, per_object("7", "30"), {"001.png": 7 * ONE + 23 * SMALL, "003.png": 7 * ONE}),
        (  # photos in folders are told by their paths
            TWO_CAMERAS,
            {"ids/cam0/001": 9 * ONE + SMALL, "ids/cam1/001": MANY, "ids/cam1/002": MANY + SMALL},
            dict(zip(TWO_CAMERAS, (9 * ONE + SMALL, MANY, MANY + SMALL), strict=True)),
        ),
        (  # folders of photos are no objects, even of binary masks
            TWO_CAMERAS,
            {"cam0/001": ONE, "cam1/001": 2 * ONE, "cam1/002": 3 * ONE},
            dict(zip(TWO_CAMERAS, (ONE, 2 * ONE, 3 * ONE), strict=True)),
        ),
        (
            TWO_CAMERAS,
            {"pot/cam0/001": LARGE, "pot/cam1/001": LARGE, "vase/cam1/002": LARGE},
            dict(zip(TWO_CAMERAS, (ONE, ONE, 2 * ONE), strict=True)),
        ),
        (TWO_CAMERAS, {"002": ONE}, {"cam1/002.jpg": ONE}),  # only one photo has the bare name
        # a photo that was not posed lends its mask to no other
        (TWO_CAMERAS, {"cam0/002": ONE, "cam0/001": ONE}, {"cam0/001.jpg": ONE}),
        (
            ("cam0/001.jpg", "001.jpg"),
            {"cam0/002": ONE, "cam0/001": ONE, "001": 2 * ONE},
            {"cam0/001.jpg": ONE, "001.jpg": 2 * ONE},
        ),
    ],
)
def test_pictures_belong_to_photos(
    tmp_path: Path, photos: tuple[str, ...], pictures: dict, expected: dict
):
    found = import_label_maps(write(tmp_path, pictures), photos)
    assert found.maps.keys() == expected.keys()
    assert all(torch.equal(found.maps[name].read(), labels) for name, labels in expected.items())
    assert found.names == ({1: "pot", 2: "vase"} if "pot" in " ".join(pictures) else {})


@pytest.mark.parametrize(
    ("photos", "pictures", "fact"),
    [
        (NAMES, {"IMG_1": ONE}, r"belongs to a photo of this capture.*001\.png"),
        (NAMES, {}, r"no folder or \.json file"),
        (NAMES, {"ids/001": MANY, "shown/001": MANY}, "Give the folder of one kind"),
        (TWO_CAMERAS, {"001": MANY}, r"001 may be of cam0/001\.jpg or of cam1/001\.jpg"),
    ],
)
def test_masks_of_another_capture_or_of_several_kinds(
    tmp_path: Path, photos: tuple[str, ...], pictures: dict, fact: str
):
    with pytest.raises(StyleSplatError, match=fact):
        import_label_maps(write(tmp_path / "masks", pictures), photos)
