"""Videos: H.264, which every browser plays, or VP9; animated WebP with transparency."""

from collections.abc import Iterable
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple

import av
from av.video.reformatter import ColorRange, Colorspace, Interpolation
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path


class _Codec(NamedTuple):
    container: str
    name: Literal["libx264", "libvpx-vp9", "libwebp_anim"]
    settings: dict[str, str]
    """Of the codec."""
    options: dict[str, str]
    """Of the container."""
    pixels: Literal["yuv420p", "bgra"] = "yuv420p"


FASTSTART = {"movflags": "faststart"}  # the index comes first, so a download plays at once
# Constant rate factors at which losses are hardly visible
H264 = {"crf": "18"}
VP9 = {"crf": "24", "b": "0", "deadline": "good", "cpu-used": "4", "row-mt": "1"}
CODECS = {
    ".mp4": _Codec("mp4", "libx264", H264, FASTSTART),
    ".mov": _Codec("mov", "libx264", H264, FASTSTART),
    ".mkv": _Codec("matroska", "libx264", H264, {}),
    ".webm": _Codec("webm", "libvpx-vp9", VP9, {}),
    ".webp": _Codec("webp", "libwebp_anim", {"quality": "85"}, {"loop": "0"}, "bgra"),
}
# FFmpeg's default for the quarter-size colours of YUV, the nearest, costs 2.5 dB of the demo's
# pictures
SMOOTH_COLOR = Interpolation.BICUBIC | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND


def write_video(
    frames: Iterable[UInt8[Tensor, "H W C"]], path: Path | str, *, fps: float | int = 30
) -> None:
    """Write a video, in the format that the suffix names.

    It is .mp4, .mov, .mkv, .webm, or .webp, which alone keeps transparency and repeats for ever.
    Others lose the last row or column of frames of odd size, as H.264 demands. Frames have three
    colours and perhaps alpha, all the same size; they are taken one by one.
    """
    rest = iter(frames)
    first = next(rest, None)
    if first is None or min(first.shape[:2]) < 2:
        raise StyleSplatError(
            f"Cannot write {path}: it needs frames of 2x2 pixels or more. Render larger ones."
        )
    codec, rate = CODECS[Path(path).suffix.lower()], Fraction(fps).limit_denominator(1001)
    encoded = _video_frame(first, codec)
    with atomic_path(path) as draft:
        with av.open(draft, "w", format=codec.container, options=codec.options) as container:
            stream = container.add_stream(codec.name, rate=rate, options=codec.settings)
            stream.height, stream.width = encoded.height, encoded.width
            stream.pix_fmt = codec.pixels
            if codec.pixels == "yuv420p":
                context = stream.codec_context
                context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG
            for frame in chain([first], rest):
                if frame.shape != first.shape:
                    raise StyleSplatError(
                        f"Cannot write {path}: the frames differ in size. Write them into a "
                        "folder, or take a round trip (--views orbit)."
                    )
                container.mux(stream.encode(_video_frame(frame, codec)))
            container.mux(stream.encode())


def _video_frame(frame: UInt8[Tensor, "H W C"], codec: _Codec) -> av.VideoFrame:
    height, width, colors = frame.shape
    if codec.pixels == "bgra":
        pixels = frame.contiguous().cpu().numpy()
        layout = "rgba" if colors == 4 else "rgb24"
        return av.VideoFrame.from_ndarray(pixels, format=layout).reformat(format="bgra")
    pixels = frame[: height // 2 * 2, : width // 2 * 2].contiguous().cpu().numpy()
    return av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
        format="yuv420p",
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        interpolation=SMOOTH_COLOR,
    )
