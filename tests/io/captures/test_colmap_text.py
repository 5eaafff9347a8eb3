"""COLMAP's files as people's scripts write them."""

import struct
from collections.abc import Callable
from pathlib import Path

import pycolmap
import pytest
import torch

from capture_files import HEIGHT, WIDTH, save_noise, with_tracks
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.captures.colmap import read_figures
from stylesplat.verbs.sfm import check

NAMES = ("a.jpg", "b.jpg", "c.jpg", "d.jpg")
CAMERA = f"1 PINHOLE {WIDTH} {HEIGHT} 60 62 31 25"


def poses(names: tuple[str, ...] = NAMES, *, between: str = "\n\n", camera: int = 1) -> str:
    rows = (f"{i + 1} 1 0 0 0 {-i} 0 0 {camera} {name}" for i, name in enumerate(names))
    return between.join(rows) + between


def points(*lines: str) -> str:
    return "\n".join([*(f"{i} {i} 0.5 5 {10 * i} 20 30 0.5 1 0 2 0" for i in range(8)), *lines])


def write(
    folder: Path,
    images: str | bytes,
    *,
    points: str | None = None,
    cameras: str = CAMERA,
    photos: tuple[str, ...] = tuple(f"images/{name}" for name in NAMES),
    sparse: str = "sparse/0",
) -> Path:
    (folder / sparse).mkdir(parents=True, exist_ok=True)
    content = images if isinstance(images, bytes) else images.encode()
    (folder / sparse / "images.txt").write_bytes(content)
    (folder / sparse / "cameras.txt").write_text(cameras)
    if points is not None:
        (folder / sparse / "points3D.txt").write_text(points)
    for row, name in enumerate(photos):
        save_noise(folder / name, seed=row)
    return folder


def names_and_places(folder: Path) -> tuple[tuple[str, ...], list[float]]:
    cameras = load(folder).cameras
    return cameras.names, cameras.viewmats[:, 0, 3].tolist()


ALL = (NAMES, [0, -1, -2, -3])
TWO_D = "\n1.5 2.5 -1 3 4 7\n"
IMAGES = {
    "empty lines of 2D points": poses(),
    "no lines of 2D points": poses(between="\n"),
    "lines of 2D points": poses(between=TWO_D),
    "whole numbers as 2D points": poses(between="\n1 2 -1 3 4 7 5 6 -1 7 8 9\n"),
    "NaN as a 2D point": poses(between="\nnan -inf -1\n"),
    "no last line": poses().rstrip(),
    "tabs and blanks": "\t" + poses().replace(" ", " \t  "),
    "comments in the midst": poses(between="\n# what follows\n\n#\n"),
    "CRLF": poses().replace("\n", "\r\n"),
    "BOM": "\ufeff# list\n" + poses(),
    "UTF-16": poses().encode("utf-16"),
    "numbers of savetxt": poses().replace(" 1 ", " 1.000000000000000000e+00 "),
    "long quaternions": poses().replace(" 1 0 0 0 ", " 7.5 0 0 0 "),
    "negative quaternions": poses().replace(" 1 0 0 0 ", " -1 0 0 0 "),
}


@pytest.mark.parametrize("text", IMAGES.values(), ids=IMAGES.keys())
def test_images_however_they_are_written(tmp_path: Path, said: list[str], text: str | bytes):
    assert names_and_places(write(tmp_path, text, points=points())) == ALL
    assert not said


@pytest.mark.parametrize("between", ["\n\n", "\n", TWO_D])
def test_a_name_is_the_rest_of_its_line(tmp_path: Path, said: list[str], between: str):
    names = ("A (1) b.jpg", "A (2)  b.jpg", "A 3 4 5.jpg", "Ä #4.jpg")
    photos = tuple(f"images/{name}" for name in names)
    folder = write(tmp_path, poses(names, between=between), points=points(), photos=photos)
    assert names_and_places(folder) == (names, [0, -1, -2, -3])
    assert not said


WRITTEN_AS = {
    "backslashes": ("cam\\{}.jpg", "images/cam/{}.jpg", "cam/{}.jpg", False),
    "the folder's name": ("images/{}.jpg", "images/{}.jpg", "{}.jpg", False),
    "the folder's name, Windows": (".\\images\\{}.jpg", "images/{}.jpg", "{}.jpg", False),
    "another machine": ("/home/me/fox/images/{}.jpg", "images/{}.jpg", "{}.jpg", False),
    "another machine's cameras": ("C:\\fox\\cam\\{}.jpg", "images/cam/{}.jpg", "cam/{}.jpg", False),
    "seen from sparse/0": ("../../images/{}.jpg", "images/{}.jpg", "{}.jpg", False),
    "another case": ("{}.JPG", "images/{}.jpg", "{}.jpg", True),
    "another extension": ("{}.jpg", "images/{}.png", "{}.png", True),
    "no extension": ("{}.0", "images/{}.0.png", "{}.0.png", True),
    "beside": ("{}.jpg", "{}.jpg", "{}.jpg", False),
    "input": ("{}.jpg", "input/{}.jpg", "{}.jpg", False),
    "another folder": ("{}.jpg", "rgb/{}.jpg", "{}.jpg", False),
    "above": ("cam/{}.jpg", "images/{}.jpg", "{}.jpg", False),
}


@pytest.mark.parametrize(
    ("written", "stored", "name", "told"), WRITTEN_AS.values(), ids=WRITTEN_AS.keys()
)
def test_photos_are_found_by_what_their_names_end_in(
    tmp_path: Path, said: list[str], written: str, stored: str, name: str, told: bool
):
    stems = ("a", "b", "c", "d")
    folder = write(
        tmp_path,
        poses(tuple(written.format(stem) for stem in stems)),
        points=points(),
        photos=tuple(stored.format(stem) for stem in stems),
    )
    (folder / "object_mask").mkdir()
    save_noise(folder / "object_mask" / "a.png")
    names = tuple(name.format(stem) for stem in stems)
    assert load(folder, masks=False).cameras.names == names
    expected = f"{written.format('a')} is {names[0]}"
    assert [expected in line for line in said] == [True] * told


def test_a_photo_stands_for_one_pose_only(tmp_path: Path, said: list[str]):
    names = ("a.jpg", "left/b.jpg", "right/b.jpg", "c.JPG", "d.jpg", "e/d.jpg", "f.jpg")
    photos = ("images/a.jpg", "images/b.jpg", "images/c.jpg", "images/d.jpg", "images/f.png")
    folder = write(tmp_path, poses(names), points=points(), photos=(*photos, "images/f.tif"))
    with pytest.raises(StyleSplatError, match=r"Only 3 of the 7 .*: e/d\.jpg, f\.jpg, left/b\.jpg"):
        load(folder)


def test_what_is_not_usable_is_left_out_by_name(tmp_path: Path, said: list[str]):
    names = tuple(f"{number}.jpg" for number in range(9))
    text = poses(names).replace("1 1 0 0 0 0 ", "1 0 0 0 0 0 ")  # no rotation
    text = text.replace("2 1 0 0 0 -1 ", "2 nan 0 0 0 -1 ").replace("0 1 2.jpg", "0 7 2.jpg")
    text = "not a pose\n" + text + "10 1 0 0 0 -5 0 0 1 8.jpg\n"
    photos = tuple(f"images/{name}" for name in names if name != "3.jpg")
    bad = ("98 nan 0 0 1 2 3", "99 inf 0 0 1 2 3", "100 0 x 0 1 2 3", "101 0 0")
    folder = write(tmp_path, text, points=points(*bad), photos=photos)
    capture = load(folder)
    assert capture.cameras.names == ("4.jpg", "5.jpg", "6.jpg", "7.jpg", "8.jpg")
    assert capture.cameras.viewmats[-1, 0, 3] == -8, "the first of two poses"
    assert capture.points is not None and capture.points.isfinite().all()
    assert len(capture.points) == 8
    told = "\n".join(said)
    for fact in (
        "hold no pose, so left out: 1.",
        "no camera 7, so left out: 2.jpg",
        "by the first pose: 8.jpg",
        "left out: 0.jpg, 1.jpg.",
        "Missing, so left out: 3.jpg",
        "4 of the 12 points",
    ):
        assert fact in told


def test_points_may_lack(tmp_path: Path, said: list[str]):
    assert load(write(tmp_path / "no file", poses())).points is None
    assert load(write(tmp_path / "none", poses(), points="# no points\n")).points is None
    assert ["has no points" in line for line in said] == [True, True]
    ply = write(tmp_path / "ply", poses())
    rows = [f"{i} 0.5 5 {i} 20 30" for i in range(9)]
    kinds = [*(f"float {name}" for name in "xyz"), "uchar red", "uchar green", "uchar blue"]
    header = ["ply", "format ascii 1.0", "element vertex 9", *(f"property {k}" for k in kinds)]
    (ply / "sparse/0/points3D.ply").write_text("\n".join([*header, "end_header", *rows, ""]))
    colors = load(ply).point_colors
    assert colors is not None and colors[8].tolist() == [8, 20, 30]
    assert len(said) == 2
    without_colors = "\n".join(f"{i} {i} 0 5" for i in range(9))
    capture = load(write(tmp_path / "plain", poses(), points=without_colors))
    assert capture.point_colors is not None and (capture.point_colors == 128).all()
    assert "9 of the 9 points" in said[-1]


def test_colors_as_fractions(tmp_path: Path):
    text = "\n".join(f"{i} {i} 0 5 1.0 0.5 0.0" for i in range(9))
    colors = load(write(tmp_path, poses(), points=text)).point_colors
    assert colors is not None and colors.tolist() == [[255, 128, 0]] * 9


def test_figures_count_what_is_there(tmp_path: Path):
    tracks = points("8 0 0 5 1 2 3 2.5 1 900 77 1", "9 0 0 5 1 2 3 -1 4 0 x y 2")
    folder = write(tmp_path, poses(), points=tracks)
    figures = read_figures(folder)
    assert figures is not None
    assert figures.shared == {"a.jpg": 9, "b.jpg": 9, "c.jpg": 0, "d.jpg": 1}
    assert figures.track_length == pytest.approx(19 / 10)
    assert figures.error == pytest.approx((8 * 0.5 + 2.5) / 9)
    assert "track length" in {each.what for each in check(load(folder)).findings}


def test_cameras_that_are_none_are_named(tmp_path: Path):
    for line, fact in (
        (f"1 FOO {WIDTH} {HEIGHT} 60 62 31 25", "camera model FOO"),
        (f"1 PINHOLE {WIDTH} {HEIGHT} 60", "PINHOLE camera has impossible numbers"),
        (f"1 PINHOLE -5 {HEIGHT} 60 62 31 25", f"-5x{HEIGHT} pixels"),
        (f"2 PINHOLE {WIDTH} {HEIGHT} 60 62 31 25", r"cameras\.txt has no camera 1"),
    ):
        with pytest.raises(StyleSplatError, match=rf"{fact}"):
            load(write(tmp_path, poses(), cameras=line))
    unused = f"{CAMERA}\n2 FOO 1 1\n"
    assert len(load(write(tmp_path, poses(), cameras=unused))) == 4


def test_binary_tracks_of_images_that_are_not_there(make_capture: Callable[..., Path]):
    folder = make_capture()
    with_tracks(folder, [[1, 2, 3]] * 8)
    path = folder / "sparse/0/images.bin"
    content = path.read_bytes()
    end = content.index(b"003.png\0") + 8
    size = 8 + 24 * struct.unpack_from("<Q", content, end)[0]
    path.write_bytes(struct.pack("<Q", 2) + content[end + size :])
    with pytest.raises(Exception, match=r"exist"):
        pycolmap.Reconstruction(path.parent)
    capture = load(folder)
    assert capture.cameras.names == ("001.png", "002.png")
    assert capture.points is not None and len(capture.points) == 12
    figures = read_figures(folder)
    assert figures is not None and set(figures.shared) == {"001.png", "002.png"}


def test_text_and_binary_agree(make_capture: Callable[..., Path], tmp_path: Path):
    folder = make_capture()
    model = pycolmap.Reconstruction(folder / "sparse/0")
    for image in model.images.values():
        turn = pycolmap.Rotation3d(torch.tensor([0.1, 0.2 * image.image_id, 0.3]).double().numpy())
        model.frames[image.frame_id].rig_from_world = pycolmap.Rigid3d(turn, [1.0, 2.0, 3.0])
    model.write_binary(folder / "sparse/0")
    binary = load(folder)
    for path in (folder / "sparse/0").iterdir():
        path.unlink()
    model.write_text(folder / "sparse/0")
    text = load(folder)
    assert text.cameras.viewmats.equal(binary.cameras.viewmats)
    expected = model.find_image_with_name("002.png").cam_from_world().matrix()
    torch.testing.assert_close(
        text.cameras.viewmats[1, :3].double().numpy(), expected, atol=1e-6, rtol=0
    )
