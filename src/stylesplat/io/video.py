"""Videos: H.264, which every browser plays, or VP9."""

from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple

import av
from av.video.reformatter import ColorRange, Colorspace, Interpolation
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path


class _Kind(NamedTuple):
    """How frames are encoded and put into a file."""

    container: str
    codec: Literal["libx264", "libvpx-vp9"]
    settings: dict[str, str]
    """Of the codec."""
    options: dict[str, str]
    """Of the container."""


FASTSTART = {"movflags": "faststart"}  # index first, so that playing starts before the end is read
# Constant rate factors at which losses are hardly visible
H264 = {"crf": "18"}
VP9 = {"crf": "24", "b": "0", "deadline": "good", "cpu-used": "4", "row-mt": "1"}
KINDS = {
    ".mp4": _Kind("mp4", "libx264", H264, FASTSTART),
    ".mov": _Kind("mov", "libx264", H264, FASTSTART),
    ".mkv": _Kind("matroska", "libx264", H264, {}),
    ".webm": _Kind("webm", "libvpx-vp9", VP9, {}),
}

# Colours, of which videos have a quarter as many as pixels, are interpolated between RGB and YUV.
# FFmpeg else takes the nearest, which costs 2.5 dB of the demo's pictures
SMOOTH_COLOR = Interpolation.BICUBIC | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND


def write_video(
    frames: Iterable[UInt8[Tensor, "H W 3"]], path: Path | str, *, fps: int = 30
) -> None:
    """Write a video, in the format that the suffix names: .mp4, .mov, .mkv or .webm.

    Frames of odd size lose their last row or column, as H.264 demands.

    Args:
        frames: All of one size; they are taken one by one, so a generator is fine.
        path: The file to make.
        fps: Frames per second.

    Raises:
        StyleSplatError: If there are no frames, they are smaller than 2x2 or differ in size, or
            the file cannot be written.
    """
    rest = iter(frames)
    first = next(rest, None)
    if first is None or min(first.shape[:2]) < 2:
        raise StyleSplatError(
            f"Cannot write {path}: it needs frames of 2x2 pixels or more. Render larger ones."
        )
    kind = KINDS[Path(path).suffix.lower()]
    with atomic_path(path) as temporary:
        with av.open(temporary, "w", format=kind.container, options=kind.options) as container:
            stream = container.add_stream(kind.codec, rate=fps, options=kind.settings)
            stream.height, stream.width = (side // 2 * 2 for side in first.shape[:2])
            stream.pix_fmt = "yuv420p"
            context = stream.codec_context
            context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG
            for frame in chain([first], rest):
                if frame.shape != first.shape:
                    raise frames_differ(path)
                container.mux(stream.encode(_video_frame(frame)))
            container.mux(stream.encode())


def frames_differ(path: Path | str) -> StyleSplatError:
    """What to tell the user about frames that make no video."""
    return StyleSplatError(
        f"Cannot write {path}: the frames differ in size. Write them into a folder, or take a "
        "round trip (--views orbit)."
    )


def _video_frame(frame: UInt8[Tensor, "H W 3"]) -> av.VideoFrame:
    height, width = (side // 2 * 2 for side in frame.shape[:2])
    pixels = frame[:height, :width].contiguous().cpu().numpy()
    return av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
        format="yuv420p",
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        interpolation=SMOOTH_COLOR,
    )
