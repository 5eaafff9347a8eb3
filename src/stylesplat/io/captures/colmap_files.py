"""The files of a COLMAP model, text or binary, record by record.

Scripts write these files too, and COLMAP's own reader refuses much of what they write. So text is
read with tolerance: names with blanks, images without their line of 2D points, points without a
track. A line that means nothing is left out, with a message. 2D points are not read: nothing needs
them, and tracks name images that are not there without harm.
"""

import re
import struct
from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from io import TextIOWrapper
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from stylesplat.errors import StyleSplatError, join_names
from stylesplat.io.files import is_file, is_there, open_binary, reading, require_regular
from stylesplat.photo_libraries import pycolmap
from stylesplat.progress import say

Record = TypeVar("Record")
PointRow = tuple[Iterable[float | int], Callable[[], Iterable[int]]]
"""Id, position, colour and error of a point, eight numbers; and what reads its images' ids."""

COLMAP_REMEDY = "Copy it again."
BINARY, TEXT = ".bin", ".txt"
COLMAP_GREY = 128  # of a point without a colour
UTF16 = (b"\xff\xfe", b"\xfe\xff")  # what text in 16 bits starts with
COLMAP_NUMBERS = re.compile(r"[-+.\d\seEnaifNAIF]*")  # a line of 2D points, perhaps with nan or inf


class CameraRecord(NamedTuple):
    id: int
    model: str
    width: int
    height: int
    params: tuple[float, ...]


class ImageRecord(NamedTuple):
    id: int
    pose: tuple[float, ...]
    """World to camera: quaternion, w first, of any length, and shift; NaN where not a number."""
    camera_id: int
    name: str


@dataclass(frozen=True)
class PointRecords:
    means: Float64[np.ndarray, "M 3"]
    """NaN where not a number."""
    colors: UInt8[np.ndarray, "M 3"]
    errors: Float64[np.ndarray, " M"]
    """Mean reprojection errors; NaN or negative where unknown."""
    images: Int64[np.ndarray, " E"]
    """Ids of the images that show points, once for each of these; they may not exist."""


def model_files(sparse: Path) -> dict[str, Path]:
    """The files of a model by kind: binary ones, as COLMAP prefers, unless more are text."""
    kinds = ("cameras", "images", "points3D")
    sets = [
        {kind: path for kind in kinds if is_file(path := sparse / f"{kind}{suffix}")}
        for suffix in (BINARY, TEXT)
    ]
    found = max(sets, key=len)
    for kind in ("cameras", "images"):
        if kind not in found:
            raise StyleSplatError(
                f"{sparse} has no {kind}.bin or {kind}.txt with the others. {COLMAP_REMEDY}"
            )
    return found


def read_camera_records(path: Path) -> dict[int, CameraRecord]:
    if path.suffix == TEXT:
        records = _whole(path, "camera", map(_parse_camera, _lines(path)))
    else:
        records = [_unpack_camera(record) for record in binary_records(path)]
    return {record.id: record for record in records}


def read_image_records(path: Path) -> list[ImageRecord]:
    if path.suffix == TEXT:
        return _whole(path, "pose", _parse_images(_lines(path)))
    return [_unpack_image(record) for record in binary_records(path)]


def read_point_records(path: Path, *, tracks: bool = False) -> PointRecords:
    """Read points, by their ids; `images` is empty unless `tracks` are wanted."""
    rows = _parse_points(path) if path.suffix == TEXT else map(_unpack_point, binary_records(path))
    numbers, images = array("d"), array("q")
    for row, track in rows:
        numbers.extend(row)
        if tracks:
            images.extend(track())
    table = np.array(numbers).reshape(-1, 8)
    table = table[table[:, 0].argsort(kind="stable")]
    return PointRecords(
        means=table[:, 1:4],
        colors=_colors(path, table[:, 1:4], table[:, 4:7]),
        errors=table[:, 7],
        images=np.array(images, np.int64),
    )


def _colors(
    path: Path, means: Float64[np.ndarray, "M 3"], colors: Float64[np.ndarray, "M 3"]
) -> UInt8[np.ndarray, "M 3"]:
    """Colours of 8 bits, from numbers up to 255 or from fractions of 1."""
    unknown = np.count_nonzero(np.isfinite(colors), axis=1) < 3
    grey = np.count_nonzero(np.isfinite(means[unknown]).all(axis=1))
    if grey:
        say(f"{grey:,} of the {len(means):,} points in {path} have no colour and start grey.")
    colors = np.where(unknown[:, None], COLMAP_GREY, colors)
    known = colors[~unknown]
    if known.size and known.max() <= 1 and (known % 1).any():
        colors[~unknown] *= 255
    return colors.round().clip(0, 255).astype(np.uint8)


# Text


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines that are neither empty nor comments, with their numbers."""
    with open_binary(path) as file, reading(path, COLMAP_REMEDY):
        encoding = "utf-16" if file.read(2) in UTF16 else "utf-8-sig"
        file.seek(0)
        text = TextIOWrapper(file, encoding, errors="surrogateescape")
        for number, line in enumerate(text, 1):
            stripped = line.strip()
            if stripped and not stripped.startswith("#"):
                yield number, stripped


def _whole(path: Path, what: str, records: Iterable[Record | int]) -> list[Record]:
    """The records; a message tells the numbers of the lines that are none."""
    found, bad = list[Record](), list[int]()
    for record in records:
        bad.append(record) if isinstance(record, int) else found.append(record)
    if bad:
        say(f"Lines of {path} that hold no {what}, so left out: {join_names(bad)}.")
    return found


def _parse_camera(line: tuple[int, str]) -> CameraRecord | int:
    number, fields = line[0], line[1].split()
    id, width, height, *params = map(_number, [fields[0], *fields[2:], "", ""])
    if not (id.is_integer() and width.is_integer() and height.is_integer()):
        return number
    return CameraRecord(int(id), fields[1].upper(), int(width), int(height), tuple(params[:-2]))


def _parse_images(lines: Iterable[tuple[int, str]]) -> Iterator[ImageRecord | int]:
    after_pose = False  # where a line of 2D points may follow; it may lack
    for number, line in lines:
        record = _parse_image(line)
        if record is not None:
            yield record
        elif not (after_pose and COLMAP_NUMBERS.fullmatch(line)):
            yield number
        after_pose = record is not None


def _parse_image(line: str) -> ImageRecord | None:
    fields = line.split(None, 9)  # the name is the rest, with its blanks
    if len(fields) < 10:
        return None
    id, *pose, camera_id = map(_number, fields[:9])
    if not (id.is_integer() and camera_id.is_integer()):
        return None
    if COLMAP_NUMBERS.fullmatch(line) and len(line.split()) % 3 == 0:
        return None  # 2D points: x, y and an id each
    return ImageRecord(int(id), tuple(pose), int(camera_id), fields[9])


def _parse_points(path: Path) -> Iterator[PointRow]:
    for _, line in _lines(path):
        fields = line.split(None, 8)
        row = [*map(_number, fields[:8]), *[np.nan] * 8]
        yield row[:8], partial(_parse_track, *fields[8:])


def _parse_track(text: str = "") -> list[int]:
    return [int(id) for id in text.split()[::2] if id.isdecimal()]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


# Binary: lengths of the records (src/colmap/scene/reconstruction_io_binary.cc)
COUNT_64, COUNT_32 = struct.Struct("<Q"), struct.Struct("<I")
CAMERA = struct.Struct("<IiQQ")  # id, model, width, height; then the parameters, float64
IMAGE = struct.Struct("<I7dI")  # id, pose, camera id; then the name, ended by a zero byte
POINT2D = 2 * 8 + 8  # x, y, point id
POINT3D = struct.Struct("<Q3d3Bd")  # id, position, colour, error; then the track
TRACK_ELEMENT = 4 + 4  # image id, index
RIG_HEAD = struct.Struct("<II")  # id, number of sensors
SENSOR = 4 + 4  # type, id
RIG_POSE = 7 * 8
FRAME_HEAD = 4 + 4 + 7 * 8  # id, rig id, pose
DATA_ID = SENSOR + 8


def check_complete(sparse: Path) -> None:
    """Raise a StyleSplatError if the records of a binary file do not end where the file does."""
    for kind in ("cameras", "images", "points3D", "rigs", "frames"):
        path = sparse / f"{kind}{BINARY}"
        require_regular(path.with_suffix(TEXT))
        if is_there(path):
            deque(binary_records(path), maxlen=0)


def binary_records(path: Path) -> Iterator[bytes]:
    """The records of a file. Raises a StyleSplatError if they do not end where the file does."""
    damaged = StyleSplatError(
        f"{path} is truncated or damaged: its records do not end where the file does. "
        f"{COLMAP_REMEDY}"
    )
    with open_binary(path) as file:
        try:
            with mmap(file.fileno(), 0, access=ACCESS_READ) as content:
                start = COUNT_64.size
                for _ in range(COUNT_64.unpack_from(content)[0]):
                    end = _end_of_record(path.stem, content, start)
                    if end > len(content):  # perhaps by more than an offset can be
                        raise damaged
                    yield content[start:end]
                    start = end
                if start != len(content):
                    raise damaged
        except (struct.error, ValueError) as error:  # the latter also of an empty file
            raise damaged from error


def _end_of_record(kind: str, content: mmap, at: int) -> int:
    count = COUNT_64  # of the list at the end of a record
    match kind:
        case "cameras":
            _, model, width, height = CAMERA.unpack_from(content, at)
            return at + CAMERA.size + 8 * _count_params(model, width, height)
        case "rigs":
            _, sensors = RIG_HEAD.unpack_from(content, at)
            at += RIG_HEAD.size + SENSOR * (sensors > 0)  # the reference sensor has no pose
            for _ in range(sensors - 1):
                has_pose = content[at + SENSOR] if at + SENSOR < len(content) else 0
                at += SENSOR + 1 + RIG_POSE * (has_pose > 0)
                if at > len(content):
                    break
            return at
        case "images":
            start, item = content.find(b"\0", at + IMAGE.size) + 1, POINT2D
            if not start:
                raise ValueError("a name without end")
        case "points3D":
            start, item = at + POINT3D.size, TRACK_ELEMENT
        case _:  # frames
            start, item, count = at + FRAME_HEAD, DATA_ID, COUNT_32
    return start + count.size + item * count.unpack_from(content, start)[0]


def _count_params(model: int, width: int, height: int) -> int:
    kind = pycolmap.CameraModelId(model)
    return len(pycolmap.Camera.create_from_model_id(0, kind, 1.0, width, height).params)


def _unpack_camera(record: bytes) -> CameraRecord:
    id, model, width, height = CAMERA.unpack_from(record)
    params = np.frombuffer(record, "<f8", offset=CAMERA.size).tolist()
    return CameraRecord(id, pycolmap.CameraModelId(model).name, width, height, tuple(params))


def _unpack_image(record: bytes) -> ImageRecord:
    id, *pose, camera_id = IMAGE.unpack_from(record)
    name = record[IMAGE.size : record.index(b"\0", IMAGE.size)]
    return ImageRecord(id, tuple(pose), camera_id, name.decode(errors="surrogateescape"))


def _unpack_point(record: bytes) -> PointRow:
    return POINT3D.unpack_from(record), partial(_unpack_track, record)


def _unpack_track(record: bytes) -> list[int]:
    return np.frombuffer(record, "<u4", offset=POINT3D.size + COUNT_64.size)[::2].tolist()
