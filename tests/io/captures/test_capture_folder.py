"""Captures as a whole: photos, cameras, label maps and points that fit each other."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from PIL import Image

from capture_files import HEIGHT, PINHOLE, WIDTH, save_noise, sfm_record
from still_life.nerfstudio import write_transforms
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import TakenLens, load, write_sfm
from stylesplat.io.captures.lens import Lens
from stylesplat.io.label_maps import LABEL_MAPS_NAMES, write_label_map, write_names

MakeCapture = Callable[..., Path]
FISHEYE = ("OPENCV_FISHEYE", (60.0, 62.0, 31.0, 25.0, 0.04, -0.01, 0.003, -0.001))
BARREL = ("OPENCV", (60.0, 62.0, 31.0, 25.0, 0.15, -0.02, 0.002, -0.001))


def paint_spots(path: Path, camera: pycolmap.Camera, viewmat: np.ndarray, points: np.ndarray):
    """One soft spot per point, where the real lens sees it, each in a channel of its own."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    places = camera.img_from_cam(points @ viewmat[:3, :3].T + viewmat[:3, 3])
    squared = [(columns - x) ** 2 + (rows - y) ** 2 for x, y in np.asarray(places)]
    pixels = (255 * np.exp(-np.stack(squared, axis=-1) / (2 * 1.5**2))).round().astype(np.uint8)
    Image.fromarray(pixels).save(path)


@pytest.mark.parametrize(("model", "params"), [PINHOLE, BARREL, FISHEYE])
@pytest.mark.parametrize("downscale", [1.0, 2.0])
def test_photos_show_points_where_the_cameras_project_them(
    make_capture: MakeCapture, model: str, params: tuple[float, ...], downscale: float
):
    folder = make_capture(model, params, count=1)
    points = np.array([[-1.5, 0.7, 5.0], [1.4, 1.0, 5.0], [0.9, -1.1, 5.0]])
    camera = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params)
    paint_spots(folder / "images/001.png", camera, np.eye(4), points)
    capture = load(folder, downscale=downscale)
    (photo,), cameras = capture.photos, capture.cameras
    assert photo.shape == (*cameras.size[::-1], 3)
    weights = photo.double() / photo.double().sum((0, 1))
    rows, columns = (torch.arange(side) + 0.5 for side in photo.shape[:2])
    seen = torch.stack([columns.double() @ weights.sum(0), rows.double() @ weights.sum(1)], dim=1)
    homogeneous = torch.from_numpy(points).float() @ cameras.Ks[0].T
    projected = homogeneous[:, :2] / homogeneous[:, 2:]
    # Half a level of rounding, far from a spot, pulls at its centroid
    torch.testing.assert_close(seen.float(), projected, atol=0.08, rtol=0)


def test_cameras_photos_and_points_of_a_colmap_capture(make_capture: MakeCapture):
    folder = make_capture()
    capture = load(folder)
    assert len(capture) == 3 and capture.path == folder
    assert capture.cameras.names == ("001.png", "002.png", "003.png")
    assert capture.cameras.viewmats.dtype == torch.float32
    assert capture.cameras.positions[:, 0].tolist() == [2, 1, 0]  # the world is as it was
    assert capture.cameras.Ks[0].tolist() == [[60, 0, 31], [0, 62, 25], [0, 0, 1]]
    assert capture.label_maps is None
    assert capture.points is not None and capture.points[3].tolist() == [3, 0.5, 5]
    with Image.open(folder / "images/002.png") as image:
        np.testing.assert_array_equal(capture.photos[1], np.asarray(image))


def test_downscale_agrees_everywhere(make_capture: MakeCapture):
    folder = make_capture(*BARREL)
    for i in range(3):
        write_label_map(torch.full((HEIGHT, WIDTH), i + 1), folder / f"object_mask/{i + 1:03d}.png")
    whole, small = load(folder), load(folder, downscale=3.0)
    width, height = small.cameras.size
    assert (width, height) == tuple(round(side / 3) for side in whole.cameras.size)
    assert small.photos[0].shape == (height, width, 3)
    assert small.label_maps is not None
    assert small.label_maps[0] is not None and small.label_maps[0].shape == (height, width)
    assert torch.equal(small.cameras.Ks, whole.cameras.downscale(3.0).Ks)


@pytest.mark.parametrize("factor", [0.5, float("inf"), float("nan")])
def test_downscale_only_shrinks(make_capture: MakeCapture, factor: float):
    with pytest.raises(StyleSplatError, match=f"Cannot downscale by {factor}"):
        load(make_capture(), downscale=factor)


def test_objects_are_called_what_lies_beside_their_label_maps(
    make_capture: MakeCapture, tmp_path: Path
):
    folder, mine = make_capture(), tmp_path / "mine"
    for masks, names in ((folder / "object_mask", {5: "vase"}), (mine, {700: "cup"})):
        write_label_map(torch.full((HEIGHT, WIDTH), 5), masks / "002.png")
        write_names(names, masks)
    found, given = load(folder), load(folder, masks=mine, downscale=2.0)
    assert found.object_names == {5: "vase"} and given.object_names == {700: "cup"}
    assert [None if m is None else int(m.max()) for m in found.label_maps or ()] == [None, 5, None]
    (mine / LABEL_MAPS_NAMES).unlink()
    assert load(folder, masks=mine).object_names == {}
    (folder / "object_mask" / LABEL_MAPS_NAMES).write_text("damaged")
    assert load(folder, masks=False).object_names == {}
    with pytest.raises(StyleSplatError, match=r"Cannot read .*names\.json"):
        load(folder)


def test_masks_may_be_drawn_on_photos_before_they_were_undistorted(
    make_capture: MakeCapture, tmp_path: Path
):
    model, params = BARREL
    sizes = ((WIDTH + wider, HEIGHT + higher) for wider in range(30) for higher in range(30))
    lenses = (Lens.create(model, *size, params) for size in sizes)
    lens = next(each for each in lenses if each.pinhole().size == (WIDTH, HEIGHT))
    folder, drawn = make_capture(), torch.zeros(lens.height, lens.width, dtype=torch.int32)
    names = ["001.png", "002.png"]
    taken = TakenLens(lens.model, lens.width, lens.height, [*lens.params], names)
    write_sfm(sfm_record(given=3, registered=3, lenses=[taken]), folder)
    drawn[5:30, 20:50] = 7
    moved = torch.from_numpy(lens.undistort(drawn.numpy(), nearest=True))
    write_label_map(drawn, tmp_path / "masks" / "001.png")  # as it was taken
    write_label_map(moved, tmp_path / "masks" / "002.png")  # as it is in the capture
    maps = load(folder, masks=tmp_path / "masks").label_maps
    assert maps is not None and not torch.equal(moved, drawn[:HEIGHT, :WIDTH])
    assert all(torch.equal(torch.as_tensor(maps[row]).int(), moved) for row in (0, 1))


def test_photos_smaller_than_their_cameras(make_capture: MakeCapture):
    folder = make_capture(images="images_2")
    for i in range(3):
        save_noise(folder / f"images_2/{i + 1:03d}.png", (WIDTH // 2, HEIGHT // 2))
    cameras = load(folder).cameras
    assert cameras.size == (WIDTH // 2, HEIGHT // 2)
    assert cameras.Ks[0].tolist() == [[30, 0, 15.5], [0, 31, 12.5], [0, 0, 1]]


def test_what_lies_far_from_all_else_is_left_out(
    make_capture: MakeCapture, tmp_path: Path, said: list[str]
):
    folder = make_capture(count=6)
    plain, model = load(folder), pycolmap.Reconstruction(folder / "sparse/0")
    image = next(each for each in model.images.values() if each.name == "003.png")
    far = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([-500.0, 300, 800]))
    image.frame.set_cam_from_world(image.camera_id, far)
    for number in range(3):
        model.add_point3D(
            np.array([1e5, 10.0 * number, -1e4]), pycolmap.Track(), np.zeros(3, np.uint8)
        )
    model.write(folder / "sparse/0")
    capture = load(folder)
    assert plain.cameras.names[2] == "003.png" and len(capture) == 5
    assert capture.cameras.names == (*plain.cameras.names[:2], *plain.cameras.names[3:])
    assert torch.equal(capture.photos[2], plain.photos[3])
    assert plain.points is not None and capture.points is not None
    assert torch.equal(capture.points, plain.points) and capture.point_colors is not None
    assert len(capture.point_colors) == len(plain.points)
    (line,) = said
    assert "003.png" in line and "3 points" in line
    assert [*capture.outliers.photos] == ["003.png"] and capture.outliers.points == 3


@pytest.mark.parametrize(
    "pose",
    [
        [[float("nan"), 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]],
        [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]],
        [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]],
        [[1, 0, 0, -1e308], [0, 1, 0, 0], [0, 0, 1, 0]],
    ],
    ids=["NaN", "scaled", "mirrored", "beyond 32 bits"],
)
def test_poses_that_are_none(make_capture: MakeCapture, said: list[str], pose: list):
    folder = make_capture()
    write_transforms(load(folder).cameras, folder)
    shutil.rmtree(folder / "sparse")
    content = json.loads((folder / "transforms.json").read_text())
    content["frames"][1]["transform_matrix"] = pose
    (folder / "transforms.json").write_text(json.dumps(content))
    assert load(folder).cameras.names == ("001.png", "003.png")
    assert said[0].startswith("1 of the 3 poses") and said[0].endswith("left out: 002.png.")
    content["frames"][2]["transform_matrix"] = pose
    (folder / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(StyleSplatError, match=r"2 of the 3 poses .* NaN .* that of 002\.png"):
        load(folder)
