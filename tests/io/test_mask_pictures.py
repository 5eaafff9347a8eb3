"""Masks as other programs write them: what their pixels mean, told by a folder together."""

from collections.abc import Callable
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter

from capture_files import write_ball_capture
from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import mask_iou
from stylesplat.io.captures.capture_folder import OBJECT_MASK, load
from stylesplat.io.label_maps import find_masks, write_label_map
from stylesplat.verbs.mask import mask

NAMES = ("0001.jpg", "0002.jpg", "0003.jpg")
Y, X = np.mgrid[:96, :64]
OBJECT = (X - 30) ** 2 + (Y - 50) ** 2 < 20**2
OTHER = (X > 50) & (Y < 30)
PHOTO = np.random.default_rng(0).integers(0, 256, (96, 64, 3), dtype=np.uint8)
Make = Callable[[], Image.Image]


def white(shape: np.ndarray = OBJECT) -> Image.Image:
    return Image.fromarray((255 * shape).astype(np.uint8))


def soft(radius: float = 1.5) -> Image.Image:
    return white().filter(ImageFilter.GaussianBlur(radius))


def with_alpha(colors: np.ndarray) -> Image.Image:
    return Image.fromarray(np.dstack([colors, np.asarray(soft())]).astype(np.uint8))


def ids(background: int = 0) -> np.ndarray:
    return np.where(OTHER, 2, np.where(OBJECT, 1, background)).astype(np.uint8)


def write(folder: Path, make: Make, suffix: str = ".png", **options: Any) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in NAMES:
        make().save(folder / f"{Path(name).stem}{suffix}", **options)
    return folder


ONE_OBJECT = {
    "black and white": (white, ".png", {}),
    "one bit": (lambda: white().convert("1"), ".png", {}),
    "as RGB": (lambda: white().convert("RGB"), ".png", {}),
    "soft": (soft, ".png", {}),
    "feathered": (lambda: soft(4), ".png", {}),
    "soft RGB": (lambda: soft().convert("RGB"), ".png", {}),
    "smaller": (lambda: white().resize((32, 48), Image.Resampling.LANCZOS), ".png", {}),
    "16 bits": (lambda: Image.fromarray(np.asarray(soft()).astype(np.uint16) * 257), ".png", {}),
    "palette": (lambda: soft().convert("P", palette=Image.Palette.ADAPTIVE), ".png", {}),
    "JPEG": (white, ".jpg", {"quality": 70}),
    "JPEG of colours": (lambda: soft().convert("RGB"), ".jpeg", {"quality": 40}),
    "cut-out": (lambda: with_alpha(PHOTO), ".png", {}),
    "white with alpha": (lambda: with_alpha(np.full_like(PHOTO, 255)), ".png", {}),
    "black with alpha": (lambda: with_alpha(np.zeros_like(PHOTO)), ".png", {}),
    "premultiplied": (lambda: Image.merge("LA", (soft(), soft())), ".png", {}),
}


@pytest.mark.parametrize("how", ONE_OBJECT)
def test_what_looks_like_the_mask_of_one_object_is_one(how: str, tmp_path: Path, said: list[str]):
    make, suffix, options = ONE_OBJECT[how]
    found = find_masks(write(tmp_path, make, suffix, **options), NAMES)
    assert [*found.maps] == [*NAMES]
    for drawn in found.maps.values():
        labels = drawn.read()
        truth = torch.from_numpy(np.asarray(white().resize(drawn.size)) >= 128)
        assert {*labels.unique().tolist()} == {0, 1} and mask_iou(labels == 1, truth) > 0.95
    (line,) = said
    assert str(tmp_path) in line and "one object" in line


@pytest.mark.parametrize(
    "labels",
    [
        ids(),
        np.where(ids() == 2, 255, ids()),
        ids() * 100,
        np.where(ids() > 0, 5, 0).astype(np.uint8),
        np.where(Y == 3, 1, 255 * OBJECT).astype(np.uint8),  # a wire
    ],
    ids=["1 and 2", "1 and 255", "100 and 200", "5", "a thin one and 255"],
)
def test_ids_stay_ids(labels: np.ndarray, tmp_path: Path, said: list[str]):
    found = find_masks(write(tmp_path, lambda: Image.fromarray(labels)), NAMES)
    assert all(np.array_equal(drawn.read(), labels) for drawn in found.maps.values())
    assert not said


def test_what_was_written_as_an_id_is_one(tmp_path: Path, said: list[str]):
    labels = torch.from_numpy(255 * OBJECT.astype(np.int64))
    write_label_map(labels, tmp_path / "0001.png")
    assert torch.equal(find_masks(tmp_path, NAMES).maps["0001.jpg"].read().long(), labels)
    assert not said


def test_ids_in_colours_over_nothing(tmp_path: Path, said: list[str]):
    colors = np.array([[0, 0, 0], [200, 9, 9], [9, 9, 200]], np.uint8)[ids()]
    write(tmp_path, lambda: Image.fromarray(np.dstack([colors, 255 * (ids() > 0).astype("u1")])))
    labels = find_masks(tmp_path, NAMES).maps["0001.jpg"].read()
    assert {*labels.unique().tolist()} == {0, 200 + 9 * 257 * 256, 9 + 9 * 256 + 200 * 65536}


@pytest.mark.parametrize(
    ("make", "suffix", "fact"),
    [
        (lambda: Image.fromarray(ids() * 85), ".jpg", r"0001\.jpg: its format changes ids"),
        (lambda: Image.fromarray(PHOTO), ".jpg", "its format changes ids"),
        (lambda: Image.fromarray(PHOTO * OBJECT[..., None]), ".png", "different colours"),
        (lambda: Image.fromarray(PHOTO[..., 0]), ".png", "different colours"),
    ],
)
def test_what_is_neither_is_refused(make: Make, suffix: str, fact: str, tmp_path: Path):
    with pytest.raises(StyleSplatError, match=fact):
        find_masks(write(tmp_path, make, suffix), NAMES)


@pytest.mark.parametrize("make", [white, soft, lambda: with_alpha(PHOTO)])
def test_a_folder_for_each_object(make: Make, tmp_path: Path):
    write(tmp_path / "pot", make)
    write(tmp_path / "vase", lambda: white(OTHER), ".jpg")
    found = find_masks(tmp_path, NAMES)
    assert found.names == {1: "pot", 2: "vase"}
    labels = found.maps["0002.jpg"].read()
    assert mask_iou(labels == 2, torch.from_numpy(OTHER)) > 0.9 and bool((labels == 1).any())


@pytest.mark.parametrize(
    "name",
    [
        *("{stem}.png", "{stem}.PNG", "{stem}.jpg.png", "{stem}_mask.png", "mask-{stem}.png"),
        *("{stem}.mask.png", "sub/{stem}.png", "{stem}.JPG.PNG"),
    ],
)
def test_names_of_masks(name: str, tmp_path: Path):
    photos = [f"IMG_{n}.jpg" for n in (1, 10, 11)]
    for number, photo in enumerate(photos, start=3):
        path = tmp_path / name.format(stem=Path(photo).stem)
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(ids() * number).save(path, format="PNG")
    found = find_masks(tmp_path, [photo.swapcase() for photo in photos])
    for number, photo in enumerate(photos, start=3):
        assert int(found.maps[photo.swapcase()].read().max()) == 2 * number


def test_training_takes_what_mask_takes(tmp_path: Path):
    folder = write_ball_capture(tmp_path / "capture", masks=False)
    capture = load(folder)
    for name in capture.cameras.names:
        (tmp_path / "masks/ball").mkdir(parents=True, exist_ok=True)
        picture = Image.new("L", capture.cameras.size)
        picture.paste(255, (10, 10, 20, 24))
        picture.filter(ImageFilter.GaussianBlur(1)).save(tmp_path / f"masks/ball/{name}.png")
    imported, loaded = (
        mask(capture, source=tmp_path / "masks"),
        load(folder, masks=tmp_path / "masks"),
    )
    copytree(tmp_path / "masks", folder / OBJECT_MASK)
    for other in (loaded, load(folder)):
        assert other.object_names == imported.object_names == {1: "ball"}
        for row in range(len(capture)):
            ours, theirs = other.labels(row), imported.labels(row)
            assert ours is not None and theirs is not None and torch.equal(ours, theirs)
            assert int((ours == 1).sum()) == 140 - 4, "all but the corners"
