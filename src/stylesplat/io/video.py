"""Videos: H.264, which every browser plays, or VP9; animated WebP with transparency; GIFs."""

from collections.abc import Iterable
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple

import av
from av.video.reformatter import ColorRange, Colorspace, Interpolation
from jaxtyping import UInt8
from PIL import Image
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.progress import track


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
GIF_SIDE = 640  # pixels of the longer side; six seconds take some ten megabytes
GIF_FPS = 1000 / 70
GIF_STEP, GIF_DELAY = 10, 20  # milliseconds: the unit of delays, and the least that browsers obey
GIF_COLORS = 256
GIF_SAMPLES = 16  # frames that the colours are chosen from


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
                    raise _sizes_differ(path)
                container.mux(stream.encode(_video_frame(frame, codec)))
            container.mux(stream.encode())


def write_gif(
    frames: Iterable[UInt8[Tensor, "H W 3"]], path: Path | str, *, fps: float | int = GIF_FPS
) -> None:
    """Write a GIF that repeats for ever, its sides 640 pixels at most.

    All frames share their 256 colours, or they would flicker. GIFs know 50, 33.3, 25, 20, ...
    frames a second.
    """
    pictures = []
    for frame in frames:
        pictures.append(Image.fromarray(frame.cpu().numpy()))
        pictures[-1].thumbnail((GIF_SIDE, GIF_SIDE), Image.Resampling.LANCZOS)
    if not pictures:
        raise StyleSplatError(f"Cannot write {path}: there are no frames. Choose other views.")
    if len({picture.size for picture in pictures}) > 1:
        raise _sizes_differ(path)
    sample = pictures[:: -(-len(pictures) // GIF_SAMPLES)]  # one below the other
    column = Image.new("RGB", (sample[0].width, sample[0].height * len(sample)))
    for row, picture in enumerate(sample):
        column.paste(picture, (0, row * picture.height))
    palette = column.quantize(GIF_COLORS)
    counted = track(pictures, "reducing colours", unit="frame")
    first, *others = (picture.quantize(palette=palette) for picture in counted)
    delay = max(GIF_DELAY, round(1000 / fps / GIF_STEP) * GIF_STEP)
    with atomic_path(path) as draft:
        first.save(draft, "GIF", save_all=True, append_images=others, duration=delay, loop=0)


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


def _sizes_differ(path: Path | str) -> StyleSplatError:
    return StyleSplatError(
        f"Cannot write {path}: the frames differ in size. Write them into a folder, or take a "
        "round trip (--views orbit)."
    )
