"""Photos and videos of a walk along a wall of textures, made by code."""

from collections.abc import Callable, Iterable
from pathlib import Path

import av
import cv2
import numpy as np
from PIL import ExifTags, Image

WIDTH, HEIGHT = 320, 240
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


def view(x: float, *, blur: float = 0, size: tuple[int, int] = (WIDTH, HEIGHT)) -> np.ndarray:
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
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        prepare(stream)
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path
