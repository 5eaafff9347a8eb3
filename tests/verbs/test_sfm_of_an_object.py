"""Poses of an object that turns before a still background, and of cut-outs."""

import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

import stylesplat as ss
from capture_files import WALL, corner, places_around, wall, write_photos
from colmap_here import colmap_in_this_process  # noqa: F401  (a fixture)
from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import mask_iou
from stylesplat.io.captures.capture_folder import read_sfm
from stylesplat.scene.capture import resize_labels

COUNT = 12
LOOP = [*range(0, COUNT, 2), *range(1, COUNT, 2)[::-1]]  # there and back: the last is by the first
ON_LOOP, ALL = 60, 66  # pairs of neighbours on a closed orbit, and of all photos
WIDTH, HEIGHT = 240, 180
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
OBJECT = ((ROWS - 90) / 64) ** 2 + ((COLUMNS - 120) / 71) ** 2 < 1
BOX = (45, 22, 195, 158)
ROOM = WALL[:HEIGHT, :WIDTH, 0]


pytestmark = pytest.mark.usefixtures("colmap_in_this_process")


@pytest.fixture(autouse=True)
def little_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stylesplat.structure_from_motion.workspace.WORKSPACE_SAMPLE", 1)
    monkeypatch.setattr("stylesplat.structure_from_motion.one_axis.ADJUSTMENTS", 5)


def turning(surroundings: np.ndarray) -> dict[str, np.ndarray]:
    images = corner(COUNT)
    small = [cv2.resize(i, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for i in images.values()]
    along = [small[place] for place in LOOP]
    return {n: np.where(OBJECT, each, surroundings) for n, each in zip(images, along, strict=True)}


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sfm") / "turntable"
    write_photos(folder, turning(ROOM))
    for name in turning(ROOM):
        (folder / "masks").mkdir(exist_ok=True)
        Image.fromarray(OBJECT).save(folder / "masks" / f"{Path(name).stem}.png")
    return folder


def sfm(photos: Path, output: Path, **options: Any) -> ss.Capture:
    """From few features."""
    return ss.sfm(photos, output, max_features=250, **options)


def assert_posed(capture: ss.Capture, compared: int = ON_LOOP, *, error: float = 0.05) -> None:
    assert len(capture) == COUNT
    steps = capture.cameras.positions.diff(dim=0).norm(dim=1)
    truth = torch.from_numpy(places_around(COUNT)[LOOP]).diff(dim=0).norm(dim=1)
    ratio = steps / truth.float()
    assert (ratio / ratio.median() - 1).abs().max() < error
    record = read_sfm(capture.path or Path())
    assert record is not None and record.numbers["reprojection_error"] < 1
    assert record.numbers["compared_pairs"] == compared


def test_what_turns_before_a_still_camera_is_posed_and_its_masks_are_written(
    photos: Path, tmp_path: Path, said: list[str]
):
    capture = sfm(photos, tmp_path / "capture")
    assert_posed(capture)
    assert any("camera stood still" in line for line in said)
    assert not any("Missing" in line for line in said), "it was meant to turn no further"
    assert_labelled(capture, 0.8)


def assert_labelled(capture: ss.Capture, least: float) -> None:
    """All photos show the object, and are known to."""
    assert capture.object_names == {1: "object"}
    for row in range(COUNT):
        labels = capture.labels(row)
        assert labels is not None
        truth = resize_labels(torch.from_numpy(OBJECT), labels.shape)
        assert mask_iou(labels > 0, truth) > least


def test_an_object_without_detail_is_told_with_the_command_for_a_box(photos: Path, tmp_path: Path):
    folder = tmp_path / "photos"
    plain = {n: np.full_like(ROOM, 40 + 15 * row) for row, n in enumerate(turning(ROOM))}
    write_photos(folder, {name: np.where(OBJECT, each, ROOM) for name, each in plain.items()})
    with pytest.raises(
        StyleSplatError, match=r"stylesplat sfm .* --object \d\d.jpg:\d\d,2\d,19\d,15\d"
    ):
        sfm(folder, tmp_path / "capture")


def shaded(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """No pixel keeps its colour, since clouds pass, but features stay."""
    light = (0.7 + 0.3 * np.sin(COLUMNS / 40 + 2 * row) for row in range(COUNT))
    return {
        n: (each * dim).astype(np.uint8)
        for (n, each), dim in zip(images.items(), light, strict=True)
    }


def test_what_moves_is_posed_where_only_features_tell_that_the_room_stays(
    tmp_path: Path, said: list[str]
):
    write_photos(tmp_path / "photos", shaded(turning(ROOM)))
    assert_posed(sfm(tmp_path / "photos", tmp_path / "capture"), error=0.1)
    assert any("what moves is posed" in line for line in said)
    (line,) = (line for line in said if line.startswith("No masks of what turns"))
    assert f"`stylesplat mask {tmp_path / 'capture'} --box " in line
    record = read_sfm(tmp_path / "capture")
    assert record is not None and record.turns, "so that it is trained alone, once it has masks"


SKIN = wall(1536)[..., 0]  # around a ball, from its one pole to the other
TILT = np.array([[1, 0, 0], [0, 0.94, -0.34], [0, 0.34, 0.94]])  # by 20 degrees


def turned_ball(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Where a ball shows, and what is on it."""
    rays = np.stack([COLUMNS - 119.5, ROWS - 89.5, np.full_like(COLUMNS, 300)], axis=-1)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    along = 4.2 * rays[..., 2]
    nearer = along**2 - (4.2**2 - 1)
    x, y, z = np.moveaxis(
        (rays * (along - np.sqrt(nearer.clip(0)))[..., None] - [0, 0, 4.2]) @ TILT, -1, 0
    )
    around = (np.arctan2(x, z) + angle) % (2 * np.pi) / (2 * np.pi) * SKIN.shape[1]
    down = (np.arcsin(y.clip(-1, 1)) / np.pi + 0.5) * SKIN.shape[0]
    maps = around.astype(np.float32), down.astype(np.float32)
    return nearer > 0, cv2.remap(SKIN, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def test_a_side_of_a_turn_whose_photos_have_no_pose_is_told(tmp_path: Path, said: list[str]):
    images, count = {}, 20
    for row in range(count):
        where, skin = turned_ball(2 * np.pi * row / count)
        skin = skin if row < 15 else np.full_like(skin, 40 + 8 * row)
        name = f"{row:02}{'-of-a-turn' * 10}.jpg"  # messages shorten it
        images["15\n.jpg" if row == 15 else name] = np.where(where, skin, ROOM)
    write_photos(tmp_path / "photos", images)
    assert len(sfm(tmp_path / "photos", tmp_path / "capture")) == 15
    assert "Only 15 of 19 photos" in said[-1], "one was left out for its name, and not tried"
    first, begin, end = (rf"{row}-of-a-turn-of-a-tu\.\.\." for row in ("00", 16, 19))
    missing = rf"Missing, in degrees from {first}: (\d+) to (\d+) \({begin} to {end}\)\. "
    part = re.search(missing, said[-1])
    assert part is not None
    assert int(part[1]) == pytest.approx(252, abs=5) and int(part[2]) == 360
    assert f"`stylesplat sfm {tmp_path / 'photos'} -o CAPTURE --object VIEW:" in said[-1]


def test_what_moves_and_is_not_posed_is_told_with_the_remedy(tmp_path: Path):
    images = turning(ROOM)
    plain = {n: np.where(OBJECT, 40, each) for n, each in [*images.items()][::3]}
    write_photos(tmp_path / "photos", shaded(images | plain))
    with pytest.raises(StyleSplatError, match=r"Only 8 of 12.* stylesplat sfm .* --object"):
        sfm(tmp_path / "photos", tmp_path / "capture")


@pytest.mark.parametrize("options", [{}, {"box": ("04.jpg", 25, 22, 175, 158)}])
def test_photos_of_a_turntable_that_were_cropped_in_their_own_ways_are_cropped_alike(
    tmp_path: Path, said: list[str], options: dict[str, Any]
):
    begin = dict(zip(turning(ROOM), (np.arange(COUNT) * 17) % 41, strict=True))
    images = {n: each[:, begin[n] : begin[n] + 200] for n, each in turning(ROOM).items()}
    write_photos(tmp_path / "photos", images)
    capture = sfm(tmp_path / "photos", tmp_path / "capture", **options)
    assert_posed(capture)
    assert any("cropped to the 162x178" in line for line in said)
    labels = capture.labels(0)
    assert labels is not None
    truth = resize_labels(torch.from_numpy(OBJECT[:, 37:199]), labels.shape)
    assert mask_iou(labels > 0, truth) > 0.8


def test_a_box_is_followed_into_all_photos(photos: Path, tmp_path: Path, said: list[str]):
    assert_posed(sfm(photos, tmp_path / "capture", box=("04", *BOX)))
    assert not any("still background" in line for line in said)


def test_masks_say_what_is_posed(photos: Path, tmp_path: Path):
    assert_posed(sfm(photos, tmp_path / "capture", masks=photos / "masks"))


def test_photos_of_a_camera_that_moves_are_not_taken_for_an_orbit(photos: Path, tmp_path: Path):
    folder = tmp_path / "photos"
    surroundings = (np.roll(ROOM, 40 * row, axis=1) for row in range(COUNT))
    turned = zip(turning(ROOM).items(), surroundings, strict=True)
    write_photos(folder, {name: np.where(OBJECT, each, room) for (name, each), room in turned})
    assert_posed(sfm(folder, tmp_path / "capture", masks=photos / "masks"), compared=ALL)


def test_photos_of_half_a_turn_are_all_matched(photos: Path, tmp_path: Path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for place, name in zip(LOOP, turning(ROOM), strict=True):
        shutil.copy(photos / name, folder / f"{place:02}.jpg")
    capture = sfm(folder, tmp_path / "capture", masks=photos / "masks")
    record = read_sfm(capture.path or Path())
    assert record is not None and record.numbers["compared_pairs"] == ALL


def test_cut_outs_are_posed_by_what_they_show(tmp_path: Path):
    """Half of them before white, the others transparent."""
    folder = tmp_path / "cut-outs"
    write_photos(folder, turning(np.full_like(ROOM, 255)))
    for path in sorted(folder.glob("*.jpg"))[: COUNT // 2]:
        pixels = np.dstack([np.asarray(Image.open(path)), 255 * OBJECT.astype(np.uint8)])
        Image.fromarray(pixels).save(path.with_suffix(".png"))
        path.unlink()
    capture = sfm(folder, tmp_path / "capture")
    assert_posed(capture, compared=ALL)
    cut_out = [*capture.cameras.names].index("00.png")
    alpha = capture.alpha(cut_out)
    assert alpha is not None and capture.object_names == {1: "object"}
    assert mask_iou(alpha > 128, resize_labels(torch.from_numpy(OBJECT), alpha.shape)) > 0.9


def test_photos_before_one_colour_get_label_maps_of_what_they_show(tmp_path: Path):
    write_photos(tmp_path / "photos", turning(np.full_like(ROOM, 255)))
    assert_labelled(sfm(tmp_path / "photos", tmp_path / "capture"), 0.95)


@pytest.mark.parametrize(
    ("masks", "names", "message"),
    [
        (np.ones_like(OBJECT), COUNT, "every pixel of each photo"),
        (np.zeros_like(OBJECT), COUNT, "no pixel of each photo"),
        (OBJECT[:, :200], COUNT, "00.jpg is 200x180, which is not the shape of the photo"),
        (OBJECT, COUNT - 2, r"no mask of 10.jpg, 11.jpg \(2 of 12 photos\)"),
        (OBJECT, 0, "No mask in .* belongs to a photo"),
    ],
)
def test_masks_that_do_not_fit(
    photos: Path, tmp_path: Path, masks: np.ndarray, names: int, message: str
):
    folder = tmp_path / "drawn"
    folder.mkdir()
    for row in range(COUNT):
        name = f"{row:02}" if row < names else f"other{row}"
        Image.fromarray(masks).save(folder / f"{name}.png")
    with pytest.raises(StyleSplatError, match=message):
        sfm(photos, tmp_path / "capture", masks=folder)


@pytest.mark.parametrize(
    ("box", "message"),
    [
        (("77.jpg", *BOX), "No view is called '77.jpg'"),
        (("04.jpg", 900, 30, 990, 90), "reaches outside 04.jpg"),
        (("04.jpg", 0, 0, 2, 2), "shows nothing that can be found again"),
        ([("04.jpg", *BOX), ("05.jpg", *BOX)], "There are 2 boxes"),
    ],
)
def test_boxes_that_hold_no_object(photos: Path, tmp_path: Path, box, message: str):
    with pytest.raises(StyleSplatError, match=message):
        sfm(photos, tmp_path / "capture", box=box)
