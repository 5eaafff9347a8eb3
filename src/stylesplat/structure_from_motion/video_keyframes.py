"""Keyframes of a video: sharp frames at even motion, whatever is wrong with some of them."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason, require_regular
from stylesplat.io.images import IMAGE_MAX_PIXELS, write_image
from stylesplat.io.renders import smooth_color
from stylesplat.photo_libraries import av
from stylesplat.progress import say, task
from stylesplat.structure_from_motion.config import MIN_PHOTOS
from stylesplat.structure_from_motion.image_measures import (
    ALL_BLURRED,
    MEASURE_SIDE,
    MEASURE_SOFT,
    CornerTracker,
    relative_sharpness,
    sharpness,
)
from stylesplat.structure_from_motion.photos import PreparedPhotos

# FFmpeg's demuxers: no playlists, which name files and addresses, and no lists of pictures
CONTAINERS = "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,asf,flv,ogg,h264,hevc,mjpeg,ivf,mxf"
OPTIONS = {"protocol_whitelist": "file", "format_whitelist": CONTAINERS}
TRANSFERS = av.video.reformatter.ColorTrc
HDR = (TRANSFERS.SMPTE2084, TRANSFERS.ARIB_STD_B67)  # HDR10 and HLG, which phones record
# Distance between keyframes, in longer sides of the picture: less is hardly a new view. In fox and
# desk half of the neighbours are more than 3 % apart
MIN_STEP = 0.015
# After such a displacement the tracker starts anew, so that a trembling hand does not add up
KEYFRAME_STRIDE = 0.03
LOST_STEP = 0.2  # displacement to a frame in which the tracker finds nothing again
OFF_CENTRE = 0.5  # share of its sharpness that a frame loses at the ends of its part of the path


@dataclass(frozen=True)
class FrameInfo:
    number: int
    """How many frames were decoded before it."""
    time: float
    """Seconds from the video's start; NaN if the video does not say."""
    travel: float
    """How far the picture has moved since the start, in longer sides."""
    sharpness: float

    @property
    def name(self) -> str:
        return _frame_name(self.number)

    @property
    def title(self) -> str:
        """What the user finds it by in a player."""
        time = "" if math.isnan(self.time) else f" at {self.time:.2f} s"
        return f"frame {self.number}{time}"


@dataclass(frozen=True)
class Video:
    path: Path
    container: av.container.InputContainer = field(repr=False)
    stream: av.VideoStream = field(repr=False)

    def frames(self) -> Iterator[tuple[int, av.VideoFrame]]:
        """All frames that can be decoded, with their numbers, in the order of presentation."""
        for number, frame in enumerate(self._decode()):
            if frame.width * frame.height > IMAGE_MAX_PIXELS:
                raise StyleSplatError(
                    f"The frames of {self.path} have more than {IMAGE_MAX_PIXELS // 10**6} "
                    "megapixels. Scale the video down."
                )
            if not frame.is_corrupt:
                yield number, frame

    def upright(self, frame: av.VideoFrame) -> UInt8[np.ndarray, "H W 3"]:
        pixel_aspect = float(self.stream.sample_aspect_ratio or 1) or 1.0
        width = max(1, round(frame.width * pixel_aspect))
        rgb = frame.reformat(width, frame.height, "rgb24", interpolation=smooth_color())
        return np.ascontiguousarray(np.rot90(rgb.to_ndarray(), round(frame.rotation / 90)))

    def _decode(self) -> Iterator[av.VideoFrame]:
        packets = self.container.demux(self.stream)
        while True:
            try:
                packet = next(packets)
            except (StopIteration, av.error.EOFError, av.error.InvalidDataError):
                return  # the rest is missing or damaged
            try:
                frames = packet.decode()
            except av.error.InvalidDataError:  # others may be fine
                continue
            yield from (frame for frame in frames if isinstance(frame, av.VideoFrame))


@contextmanager
def open_video(path: Path) -> Iterator[Video]:
    """Open a video; errors of FFmpeg within the block name the file."""
    require_regular(path)
    try:
        with av.open(str(path), options=OPTIONS, metadata_errors="replace") as container:
            covers = (s.disposition & s.disposition.attached_pic for s in container.streams.video)
            streams = [
                s for s, cover in zip(container.streams.video, covers, strict=True) if not cover
            ]
            if not streams:
                raise StyleSplatError(f"{path} has no pictures, only sound. Give a video.")
            streams[0].thread_type = "AUTO"
            yield Video(path, container, streams[0])
    except (av.error.FFmpegError, ValueError, UnicodeError) as error:
        fault = getattr(error, "strerror", None) or reason(error)
        raise StyleSplatError(
            f"{path} is no video that can be decoded: {fault}. Give MP4, MOV, MKV or WebM, "
            "or a folder of photos."
        ) from error


def select_keyframes(path: Path, most: int) -> PreparedPhotos:
    """Find sharp frames of a video, equally far apart by how far the picture moves."""
    frames = _measure_frames(path)
    keyframes = pick_keyframes(frames, most)
    if len(frames) < MIN_PHOTOS:
        raise StyleSplatError(
            f"{path} has {len(frames) or 'no'} frame{'s' * (len(frames) != 1)} that can be "
            "decoded. Give a video in which the camera walks around, or a folder of photos."
        )
    if np.median([frame.sharpness for frame in keyframes]) < ALL_BLURRED:
        raise StyleSplatError(
            f"The frames of {path} are all blurred. Film in more light, and move more slowly."
        )
    if len(keyframes) < MIN_PHOTOS:
        raise StyleSplatError(
            f"The camera hardly moves in {path}: {len(keyframes)} of its {len(frames)} frames "
            "differ. Film while you walk around."
        )
    values = relative_sharpness([frame.sharpness for frame in keyframes])
    sharp = {f.name: value for f, value in zip(keyframes, values, strict=True)}
    kept = [frame for frame in keyframes if sharp[frame.name] >= MEASURE_SOFT]
    return PreparedPhotos(
        names=tuple(frame.name for frame in kept),
        ordered=True,
        origins={frame.name: frame.title for frame in kept},
        sharpness={frame.name: sharp[frame.name] for frame in kept},
        left_out={frame.title: "blurred" for frame in keyframes if frame not in kept},
    )


def pick_keyframes(frames: Sequence[FrameInfo], most: int) -> list[FrameInfo]:
    """Cut the path of the camera into equal parts, and pick the sharpest frame of each."""
    if not frames:
        return []
    start, length = frames[0].travel, frames[-1].travel - frames[0].travel
    parts = max(1, min(most, math.floor(length / MIN_STEP) + 1))
    part = length / parts or 1.0
    best: dict[int, tuple[float, FrameInfo]] = {}
    for frame in frames:
        place = (frame.travel - start) / part
        index = min(int(place), parts - 1)
        score = frame.sharpness * (1 - OFF_CENTRE * abs(2 * (place - index) - 1))
        if index not in best or score > best[index][0]:
            best[index] = score, frame
    return [frame for _, frame in best.values()]


def write_keyframes(path: Path, names: Sequence[str], folder: Path) -> None:
    missing = {*names}
    if not missing:
        return
    with open_video(path) as video, task("writing frames", len(missing), unit="frame") as bar:
        for number, frame in video.frames():
            if (name := _frame_name(number)) in missing:
                write_image(torch.from_numpy(video.upright(frame)), folder / name)
                missing.remove(name)
                bar.advance()
            if not missing:
                return
    raise StyleSplatError(f"{path} has changed while it was read. Try again.")


def _measure_frames(path: Path) -> list[FrameInfo]:
    frames: list[FrameInfo] = []
    tracker, tracker_start, travel = None, 0.0, 0.0
    with (
        open_video(path) as video,
        task("measuring frames", video.stream.frames or None, unit="frame") as bar,
    ):
        for number, frame in video.frames():
            if not frames and frame.color_trc in HDR:
                say(f"{path.name} is HDR: its colours are taken as they are, so photos look flat.")
            grey = _small_grey(frame)
            moved = tracker.displacement(grey) if tracker else 0.0
            travel = max(travel, tracker_start + (LOST_STEP if moved is None else moved))
            if tracker is None or moved is None or moved > KEYFRAME_STRIDE:
                tracker, tracker_start = CornerTracker(grey), travel
            time = math.nan if frame.time is None else frame.time
            frames.append(FrameInfo(number, time, travel, sharpness(grey)))
            bar.advance()
    return frames


def _small_grey(frame: av.VideoFrame) -> UInt8[np.ndarray, "h w"]:
    scale = min(1.0, MEASURE_SIDE / max(frame.width, frame.height))
    width, height = (max(1, round(x * scale)) for x in (frame.width, frame.height))
    area = av.video.reformatter.Interpolation.AREA
    small = frame.reformat(width, height, "gray", interpolation=area)
    return np.ascontiguousarray(small.to_ndarray())


def _frame_name(number: int) -> str:
    return f"frame_{number:06d}.jpg"
