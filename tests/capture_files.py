"""Photos and captures on disk: noise, balls, walks past a corner; boxes, a detector, records."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pycolmap
import pytest
import torch
from PIL import ExifTags, Image
from torch import Tensor

from balls import CAMERAS, PLAIN, SPLATS, enlarged
from still_life.nerfstudio import write_transforms
from stylesplat.imaging.similarity import mask_iou
from stylesplat.io.captures.capture_folder import SfmRecord
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.posed_files import PosedFiles
from stylesplat.io.label_maps import write_label_map
from stylesplat.masks import from_boxes as mask_boxes
from stylesplat.masks import working_splat as working
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.capture import Capture, resize_labels
from stylesplat.scene.scene import Scene
from stylesplat.selection.labels import render_labels
from stylesplat.selection.text import Detections
from stylesplat.structure_from_motion.photos import PreparedPhotos

WIDTH, HEIGHT = 64, 48
PINHOLE = ("PINHOLE", (60.0, 62.0, 31.0, 25.0))


def save_noise(path: Path, size: tuple[int, int] = (WIDTH, HEIGHT), seed: int = 0) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, (size[1], size[0], 3), np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def reconstruction(model: str, params: Sequence[float], count: int) -> pycolmap.Reconstruction:
    """Cameras one unit apart along x, looking along z; four points at depth 5."""
    result = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params, camera_id=1)
    result.add_camera_with_trivial_rig(camera)
    for i in range(count):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([-float(i), 0.0, 0.0]))
        name = f"{count - i:03d}.png"  # ids run against the names
        image = pycolmap.Image(name=name, camera_id=1, image_id=i + 1)
        result.add_image_with_trivial_frame(image, pose)
    for i in range(4):
        color = np.array([10 * i, 20, 30], np.uint8)
        result.add_point3D(np.array([i, 0.5, 5.0]), pycolmap.Track(), color)
    return result


def write_capture(
    folder: Path,
    model: str = PINHOLE[0],
    params: Sequence[float] = PINHOLE[1],
    *,
    count: int = 3,
    text: bool = False,
    sparse: str = "sparse/0",
    images: str = "images",
) -> Path:
    """Write a reconstruction and photos of noise, and return the folder."""
    (folder / sparse).mkdir(parents=True)
    posed = reconstruction(model, params, count)
    (posed.write_text if text else posed.write)(folder / sparse)
    for i in range(count):
        save_noise(folder / images / f"{i + 1:03d}.png", seed=i)
    return folder


def with_tracks(folder: Path, seen_by: list[list[int]]) -> None:
    """Give the reconstruction points that are seen in the photos of these ids."""
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    for image in model.images.values():
        seen = [point for point, ids in enumerate(seen_by) if image.image_id in ids]
        image.points2D = pycolmap.Point2DList(
            [pycolmap.Point2D(np.array([3.0 + point % 50, 5.0])) for point in seen]
        )
    for point, ids in enumerate(seen_by):
        track = pycolmap.Track()
        for id in ids:
            index = [p for p, others in enumerate(seen_by) if id in others].index(point)
            track.add_element(id, index)
        key = model.add_point3D(
            np.array([0.01 * point, 0.5, 5.0]), track, np.array([9, 9, 9], np.uint8)
        )
        model.points3D[key].error = 3.0
    model.write(folder / "sparse" / "0")


def lenses_of(posed: PosedFiles) -> list[Lens]:
    """The lenses of photos that all have one."""
    return [lens for lens in posed.lenses if lens is not None]


# The balls as photos on disk.

ONLY_BALLS = SPLATS[torch.arange(len(SPLATS)) >= 200]  # the table comes first


def write_ball_capture(folder: Path, cameras: Cameras = CAMERAS, *, masks: bool = True) -> Path:
    """Write photos, with label maps if wanted, in nerfstudio's layout, and return the folder."""
    (folder / "images").mkdir(parents=True)
    for row, name in enumerate(cameras.names):
        image = rasterize(SPLATS, cameras[row])[0][0].clamp(0, 1)
        pixels = (255 * image).round().to(torch.uint8).numpy()
        Image.fromarray(pixels).save(folder / "images" / name, quality=95)
        if masks:
            labels = render_labels(SPLATS, cameras[row])
            write_label_map(labels, folder / "object_mask" / f"{Path(name).stem}.png")
    write_transforms(cameras, folder, points=SPLATS.means)
    return folder


def write_cut_outs(folder: Path, cameras: Cameras = CAMERAS) -> Path:
    """Write photos of the balls, without the table, before nothing: PNG files with alpha."""
    (folder / "images").mkdir(parents=True)
    names = tuple(f"{Path(name).stem}.png" for name in cameras.names)
    for row, name in enumerate(names):
        image, alphas, _ = rasterize(ONLY_BALLS, cameras[row])
        colors = image[0] / alphas[0].clamp(min=1e-6)  # PNG keeps colours apart from alpha
        pixels = torch.cat([colors, alphas[0]], dim=-1).clamp(0, 1)
        pixels = (255 * pixels).round().to(torch.uint8).numpy()
        Image.fromarray(pixels).save(folder / "images" / name)
    write_transforms(replace(cameras, names=names), folder, points=ONLY_BALLS.means)
    return folder


# Boxes around the balls in photos of theirs, and how well masks fit them.

HALF = enlarged(CAMERAS, 2)  # that `mask` works at
LARGE = enlarged(CAMERAS, 4)  # the photos; worked on at half of that


# Four pixels around the balls 3 and 7
VASE = ("0001.jpg", (26.0, 34.0, 93.0, 96.0))
CUP = ("0005.jpg", (25.0, 34.0, 94.0, 100.0))
BALLS = Scene(PLAIN, CAMERAS)  # at a size of its own, as `import` and `train --downscale` make them


def agreement(masked: Capture, id: int, ball: int) -> list[float]:
    """IoU per photo of what is masked as an id with a ball, at the size that it was made at."""
    assert masked.label_maps is not None
    ious = []
    for row in range(len(masked)):
        labels, truth = masked.label_maps[row], render_labels(SPLATS, HALF[row]) == ball
        assert labels is not None
        assert labels.shape == masked.cameras[row].size[::-1]
        ious.append(mask_iou(resize_labels(labels, truth.shape) == id, truth))
    return ious


def work_at_half_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut objects out of photos of half the size."""
    monkeypatch.setattr(mask_boxes, "DRAWN_BOX_SIZE", HALF.size[0])


def fail_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Training and rendering fail."""

    def fail(*args: Any, **kwargs: Any) -> None:
        raise AssertionError("work has begun")

    monkeypatch.setattr(working, "fit", fail)
    monkeypatch.setattr(mask_boxes, "propagate_boxes", fail)


# A detector without a network: it knows three words, and finds them by colour.

CHANNELS = {"red": 0, "green": 1, "blue": 2}
NOTHING = Detections(torch.zeros(0, 4), torch.zeros(0))
SCORE = 0.8


class ColorDetector:
    """The box around all that has one of the colours asked for, a box for each."""

    def __init__(self) -> None:
        self.sizes: set[tuple[int, ...]] = set()

    def detect(self, picture: Tensor, phrase: str) -> Detections:
        assert picture.dtype == torch.uint8
        self.sizes.add(tuple(picture.shape))
        boxes = []
        for word in CHANNELS.keys() & phrase.split():
            value = picture.float()[..., CHANNELS[word]]
            places = (2 * value > picture.float().sum(dim=2) + 40).nonzero().float()
            if len(places):
                (top, left), (bottom, right) = places.amin(dim=0), places.amax(dim=0)
                boxes.append(torch.stack([left, top, right + 1, bottom + 1]))
        if not boxes:
            return NOTHING
        return Detections(torch.stack(boxes), torch.full((len(boxes),), SCORE))


# Photos of a textured corner, three walls, from known places.

CORNER_WIDTH, CORNER_HEIGHT, FOCAL = 320, 240, 330.0
TEXTURE = 512  # pixels a side
K = np.array([[FOCAL, 0, CORNER_WIDTH / 2], [0, FOCAL, CORNER_HEIGHT / 2], [0, 0, 1]])


def places_around(count: int, spread: float = 1.0) -> np.ndarray:
    """Places on an arc in front of the corner, at changing heights."""
    angles = np.pi / 4 + spread * np.linspace(-0.45, 0.45, count)
    heights = 1.1 + 0.35 * spread * np.sin(3 * np.arange(count))
    return np.stack([2.6 * np.cos(angles), 2.6 * np.sin(angles), heights], axis=1)


def towards(places: np.ndarray, target: Sequence[float] = (0.35, 0.35, 0.45)) -> np.ndarray:
    """World to camera, for cameras that look at one point."""
    up = torch.tensor([0.0, 0.0, 1.0])
    aim = torch.tensor([float(x) for x in target])
    mats = look_at(torch.from_numpy(places).float(), aim, up)
    return mats.double().numpy()


def turned(count: int) -> np.ndarray:
    """World to camera, for cameras that turn in one place."""
    place = np.array([1.9, 1.9, 1.1])
    targets = [(0.9 - 1.3 * s, -0.4 + 1.3 * s, 0.45) for s in np.linspace(0, 1, count)]
    return np.concatenate([towards(place[None], target) for target in targets])


def photograph_corner(viewmat: np.ndarray, seed: int = 0) -> np.ndarray:
    """What one camera sees: each pixel's ray meets the nearest of three walls."""
    rows, columns = np.mgrid[:CORNER_HEIGHT, :CORNER_WIDTH] + 0.5
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    rays = pixels @ np.linalg.inv(K).T @ viewmat[:3, :3]
    eye = -viewmat[:3, :3].T @ viewmat[:3, 3]
    picture, nearest = (
        np.full((CORNER_HEIGHT, CORNER_WIDTH), 128.0, np.float32),
        np.full((CORNER_HEIGHT, CORNER_WIDTH), 1e9),
    )
    for axis in range(3):
        t = -eye[axis] / rays[..., axis]
        hits = np.delete(eye + t[..., None] * rays, axis, axis=-1).astype(np.float32) * 150
        seen = (t > 0) & (t < nearest)
        wall = cv2.remap(
            _texture(seed, axis),
            hits[..., 0] + 150,
            hits[..., 1] + 150,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT,
        )
        picture[seen], nearest[seen] = wall[seen], t[seen]
    return picture.clip(0, 255).astype(np.uint8)


def _texture(seed: int, axis: int) -> np.ndarray:
    rng = np.random.default_rng([seed, axis])
    layers = [
        cv2.resize(rng.uniform(-1, 1, (n, n)).astype(np.float32), (TEXTURE, TEXTURE))
        for n in (16, 48, 128)
    ]
    return 128 + 75 * np.sum(layers, axis=0)


def write_photos(
    folder: Path, pictures: dict[str, np.ndarray], sharpness: dict[str, float] | None = None
) -> PreparedPhotos:
    """Write pictures by name."""
    for name, picture in pictures.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture).convert("RGB").save(path, quality=95)
    names = tuple(pictures)
    usual = dict.fromkeys(names, 1.0)
    own = dict(zip(names, names, strict=True))
    return PreparedPhotos(names, ordered=False, origins=own, sharpness=usual | (sharpness or {}))


def corner(count: int = 10, *, seed: int = 0, prefix: str = "") -> dict[str, np.ndarray]:
    """Photos of the corner from an arc, by name."""
    mats = towards(places_around(count, spread=count / 10))
    return {f"{prefix}{i:02}.jpg": photograph_corner(m, seed) for i, m in enumerate(mats)}


# Photos and videos of a walk along a wall of textures, made by code.

WALK_WIDTH, WALK_HEIGHT = 320, 240
TINT = np.array([1.0, 0.9, 0.7], np.float32)


def wall(width: int = 3200, seed: int = 0) -> np.ndarray:
    """A long picture with detail at every size."""
    generator = np.random.default_rng(seed)
    sizes = [(width >> level, 480 >> level) for level in range(6)]
    layers = [generator.uniform(-1, 1, (h, w)).astype(np.float32) for w, h in sizes]
    scaled = [cv2.resize(layer, sizes[0], interpolation=cv2.INTER_CUBIC) for layer in layers]
    weighed = sum(layer * 1.6**level for level, layer in enumerate(scaled))
    contrast = 40 / np.std(weighed)  # grey levels
    grey = np.clip(128 + contrast * np.asarray(weighed), 0, 255)
    return (grey[:, :, None] * TINT).astype(np.uint8)


WALL = wall()


def view(
    x: float, *, blur: float = 0, size: tuple[int, int] = (WALK_WIDTH, WALK_HEIGHT)
) -> np.ndarray:
    """What is seen of the wall from somewhere, blurred over so many pixels by motion."""
    shift = np.array([[1, 0, x], [0, 1, 0]], np.float32)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpAffine(WALL, shift, size, flags=flags)
    return cv2.blur(seen, (int(blur), 1)) if blur else seen


def save(
    path: Path, pixels: np.ndarray, *, orientation: int | None = None, focal: int | None = None
) -> Path:
    """Write a photo as a phone does, JPEG at high quality."""
    exif = Image.Exif()
    if orientation:
        exif[ExifTags.Base.Orientation] = orientation
    if focal:
        exif[ExifTags.Base.Make] = "Maker"
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = focal
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray(np.ascontiguousarray(pixels))
    if path.suffix.lower() in (".jpg", ".jpeg"):
        picture.save(path, exif=exif, quality=95, subsampling=0)
    else:
        picture.save(path, exif=exif)
    return path


def walk(folder: Path, count: int = 5, *, step: float = 24) -> Path:
    """A folder of photos of a walk, named as cameras do."""
    for index in range(count):
        save(folder / f"IMG_{index + 8}.jpg", view(index * step))
    return folder


def film(
    path: Path,
    frames: Iterable[np.ndarray],
    prepare: Callable[[av.VideoStream], None] = lambda stream: None,
    codec: str = "libx264",
) -> Path:
    """Write a video of frames of one size."""
    with av.open(path, "w") as container:
        stream = container.add_stream(codec, rate=30, options={"crf": "15"})
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = WALK_WIDTH, WALK_HEIGHT, "yuv420p"
        prepare(stream)
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


# What `sfm` writes down, where a test cares about a part of it only.


def sfm_record(**known: Any) -> SfmRecord:
    """A record of which only some fields say something."""
    nothing = ("left_out", "unregistered", "origins", "frame", "settings", "numbers", "libraries")
    empty = {name: dict[str, Any]() for name in nothing}
    return SfmRecord(**{"source": "photos", "digest": "", **empty, **known})
