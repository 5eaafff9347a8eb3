"""Whether COLMAP's binary files are complete.

pycolmap (4.2) does not notice where a file ends: a truncated `cameras.bin` loads with garbage in
it, and other files make it take gigabytes before it fails. So the lengths of the records, nothing
else, are followed here first.
"""

import struct
from collections.abc import Callable
from mmap import ACCESS_READ, mmap
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.io.files import cannot_read, require_regular

# The records of COLMAP's binary format (src/colmap/scene/reconstruction_io_binary.cc)
CAMERA = struct.Struct("<IiQQ")  # id, model, width, height; then the parameters, float64
IMAGE_HEAD = 4 + 7 * 8 + 4  # id, pose, camera id; then the name, ended by a zero byte
POINT2D = 2 * 8 + 8  # x, y, point id
POINT3D_HEAD = 8 + 3 * 8 + 3 + 8  # id, place, colour, error
TRACK_ELEMENT = 4 + 4  # image id, index
RIG_HEAD = struct.Struct("<II")  # id, number of sensors
SENSOR = 4 + 4  # type, id
RIG_POSE = 7 * 8
FRAME_HEAD = 4 + 4 + 7 * 8  # id, rig id, pose
DATA_ID = SENSOR + 8
COUNT = struct.Struct("<Q")
FRAME_COUNT = struct.Struct("<I")


def check_complete(sparse: Path) -> None:
    """Follow the records of each binary file to its end.

    Raises:
        StyleSplatError: If a file ends too early or too late.
    """
    for name, skip in SKIPPERS.items():
        path = sparse / f"{name}.bin"
        require_regular(path)
        require_regular(path.with_suffix(".txt"))
        if path.exists() and not _holds(path, skip):
            raise StyleSplatError(
                f"{path} is truncated or damaged: its records do not end where the file does. "
                "Copy it again."
            )


def _holds(path: Path, skip: Callable[[mmap, int], int]) -> bool:
    try:
        with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as content:
            return _is_complete(content, skip)
    except ValueError:  # an empty file
        return False
    except OSError as error:
        raise cannot_read(path, error) from error


def _is_complete(content: mmap, skip: Callable[[mmap, int], int]) -> bool:
    try:
        (count,) = COUNT.unpack_from(content)
        offset = COUNT.size
        for _ in range(count):
            offset = skip(content, offset)
            if offset > len(content):  # perhaps by more than can be an offset at all
                return False
    except (struct.error, ValueError):
        return False
    return offset == len(content)


def _skip_camera(content: mmap, offset: int) -> int:
    _, model, width, height = CAMERA.unpack_from(content, offset)
    camera = pycolmap.Camera.create_from_model_id(
        0, pycolmap.CameraModelId(model), 1.0, width, height
    )
    return offset + CAMERA.size + 8 * len(camera.params)


def _skip_image(content: mmap, offset: int) -> int:
    end = content.find(b"\0", offset + IMAGE_HEAD) + 1
    if not end:
        raise ValueError("a name without end")
    return end + COUNT.size + POINT2D * COUNT.unpack_from(content, end)[0]


def _skip_point(content: mmap, offset: int) -> int:
    end = offset + POINT3D_HEAD
    return end + COUNT.size + TRACK_ELEMENT * COUNT.unpack_from(content, end)[0]


def _skip_rig(content: mmap, offset: int) -> int:
    _, sensors = RIG_HEAD.unpack_from(content, offset)
    offset += RIG_HEAD.size + SENSOR * (sensors > 0)  # the reference sensor has no pose
    for _ in range(sensors - 1):
        (has_pose,) = struct.unpack_from("<B", content, offset + SENSOR)
        offset += SENSOR + 1 + RIG_POSE * (has_pose > 0)
    return offset


def _skip_frame(content: mmap, offset: int) -> int:
    end = offset + FRAME_HEAD
    return end + FRAME_COUNT.size + DATA_ID * FRAME_COUNT.unpack_from(content, end)[0]


SKIPPERS = {
    "cameras": _skip_camera,
    "images": _skip_image,
    "points3D": _skip_point,
    "rigs": _skip_rig,
    "frames": _skip_frame,
}
