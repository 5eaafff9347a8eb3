"""Videos that every browser plays."""

from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import av
from av.video.reformatter import ColorRange, Colorspace, Interpolation
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path

QUALITY = "18"  # x264's constant rate factor: losses are hardly visible
FASTSTART = {"movflags": "faststart"}  # index first, so that playing starts before the end is read

# Colours, of which videos have a quarter as many as pixels, are interpolated between RGB and YUV.
# FFmpeg else takes the nearest, which costs 2.5 dB of the demo's pictures
SMOOTH_COLOR = Interpolation.BICUBIC | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND


def write_video(
    frames: Iterable[UInt8[Tensor, "H W 3"]], path: Path | str, *, fps: int = 30
) -> None:
    """Write an H.264 MP4. Frames of odd size lose their last row or column, as H.264 demands.

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
        raise StyleSplatError(f"Cannot write {path}: it needs frames of 2x2 pixels or more.")
    with atomic_path(path) as temporary:
        with av.open(temporary, "w", format="mp4", options=FASTSTART) as container:
            stream = container.add_stream("libx264", rate=fps, options={"crf": QUALITY})
            stream.height, stream.width = (side // 2 * 2 for side in first.shape[:2])
            stream.pix_fmt = "yuv420p"
            context = stream.codec_context
            context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG
            for frame in chain([first], rest):
                if frame.shape != first.shape:
                    raise StyleSplatError(f"Cannot write {path}: the frames differ in size.")
                container.mux(stream.encode(_video_frame(frame)))
            container.mux(stream.encode())


def _video_frame(frame: UInt8[Tensor, "H W 3"]) -> av.VideoFrame:
    height, width = (side // 2 * 2 for side in frame.shape[:2])
    pixels = frame[:height, :width].contiguous().cpu().numpy()
    return av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
        format="yuv420p",
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        interpolation=SMOOTH_COLOR,
    )
