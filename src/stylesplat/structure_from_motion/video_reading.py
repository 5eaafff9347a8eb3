"""The frames of a video, one after the other, whatever is wrong with some of them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.error import EOFError as EndOfFile
from av.error import FFmpegError, InvalidDataError
from av.video.frame import VideoFrame
from av.video.reformatter import ColorTrc, Interpolation
from av.video.stream import VideoStream
from jaxtyping import UInt8

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason, require_regular
from stylesplat.io.images import MAX_PIXELS
from stylesplat.io.video import SMOOTH_COLOR

# Of FFmpeg: no playlists, which name files and addresses, and no lists of pictures
CONTAINERS = "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,asf,flv,ogg,h264,hevc,mjpeg,ivf,mxf"
OPTIONS = {"protocol_whitelist": "file", "format_whitelist": CONTAINERS}
HIGH_RANGE = (ColorTrc.SMPTE2084, ColorTrc.ARIB_STD_B67)  # HDR10 and HLG, which phones record
QUARTER = 90  # degrees


@dataclass(frozen=True)
class Frame:
    """One frame of a video, not yet converted."""

    number: int
    """How many were decoded before it."""
    time: float
    """Seconds from the video's start; NaN if the video does not say."""
    image: VideoFrame = field(repr=False)
    """What FFmpeg decoded."""

    @property
    def high_range(self) -> bool:
        """Whether its colours are those of HDR, which show flat as they are."""
        return self.image.color_trc in HIGH_RANGE

    def grey(self, side: int) -> UInt8[np.ndarray, "h w"]:
        """Small and grey, as stored, with a longer side of so many pixels or fewer."""
        scale = min(1.0, side / max(self.image.width, self.image.height))
        width, height = (max(1, round(x * scale)) for x in (self.image.width, self.image.height))
        small = self.image.reformat(width, height, "gray", interpolation=Interpolation.AREA)
        return np.ascontiguousarray(small.to_ndarray())

    def upright(self, pixel_width: float) -> UInt8[np.ndarray, "H W 3"]:
        """In full, as it is shown.

        Args:
            pixel_width: Of one of its pixels, by its height.
        """
        width = max(1, round(self.image.width * pixel_width))
        rgb = self.image.reformat(
            width, self.image.height, "rgb24", interpolation=SMOOTH_COLOR
        ).to_ndarray()
        return np.ascontiguousarray(np.rot90(rgb, round(self.image.rotation / QUARTER)))


@dataclass(frozen=True)
class Video:
    """A video that is open."""

    path: Path
    """Its file."""
    container: InputContainer = field(repr=False)
    """What FFmpeg reads it by."""
    stream: VideoStream = field(repr=False)
    """The pictures, as opposed to sound."""

    @property
    def pixel_width(self) -> float:
        """Of a pixel, by its height."""
        return float(self.stream.sample_aspect_ratio or 1) or 1.0

    @property
    def count(self) -> int | None:
        """Frames that it says it has."""
        return self.stream.frames or None

    def frames(self) -> Iterator[Frame]:
        """All frames that can be decoded, in the order in which they are shown.

        Raises:
            StyleSplatError: If they are too large.
        """
        number = 0
        for image in self._decoded():
            if image.width * image.height > MAX_PIXELS:
                raise StyleSplatError(
                    f"The frames of {self.path} have more than {MAX_PIXELS // 10**6} megapixels. "
                    "Scale the video down."
                )
            if not image.is_corrupt:
                yield Frame(number, float("nan") if image.time is None else image.time, image)
            number += 1

    def _decoded(self) -> Iterator[VideoFrame]:
        packets = self.container.demux(self.stream)
        while True:
            try:
                packet = next(packets)
            except (StopIteration, EndOfFile, InvalidDataError):  # the rest is missing or damaged
                return
            try:
                images = packet.decode()
            except InvalidDataError:  # others may be fine
                continue
            yield from (image for image in images if isinstance(image, VideoFrame))


@contextmanager
def opened_video(path: Path) -> Iterator[Video]:
    """Open a video; whatever FFmpeg raises within the block names the file.

    Raises:
        StyleSplatError: If there is no such file, or no video in it that can be decoded.
    """
    require_regular(path)
    try:
        with av.open(str(path), options=OPTIONS, metadata_errors="replace") as container:
            streams = [s for s in container.streams.video if not _is_cover(s)]
            if not streams:
                raise StyleSplatError(f"{path} has no pictures, only sound. Give a video.")
            streams[0].thread_type = "AUTO"
            yield Video(path, container, streams[0])
    except (FFmpegError, ValueError, UnicodeError) as error:
        raise StyleSplatError(
            f"{path} is no video that can be decoded: {_said(error)}. Give MP4, MOV, MKV or WebM, "
            "or a folder of photos."
        ) from error


def _is_cover(stream: VideoStream) -> bool:
    return bool(stream.disposition & stream.disposition.attached_pic)


def _said(error: Exception) -> str:
    return getattr(error, "strerror", None) or reason(error)
