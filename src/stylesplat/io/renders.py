"""Rendered views on disk: a folder under the photos' names, a video, or one picture."""

from collections import Counter
from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Literal, NamedTuple

from jaxtyping import UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import (
    atomic_folder,
    atomic_path,
    locked_folder,
    refuse_file,
    refuse_occupied,
)
from stylesplat.io.files import resolve_within
from stylesplat.io.images import ViewPicture, write_image, write_numbers
from stylesplat.io.kinds import PHOTOS, SPLATS, VIDEOS
from stylesplat.io.label_maps import write_label_map
from stylesplat.photo_libraries import av


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


def smooth_color() -> int:
    """How FFmpeg interpolates the quarter-size colours of YUV.

    Its default, the nearest, costs 2.5 dB of the demo's pictures.
    """
    kinds = av.video.reformatter.Interpolation
    return kinds.BICUBIC | kinds.FULL_CHR_H_INT | kinds.ACCURATE_RND


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
                context, colors = stream.codec_context, av.video.reformatter
                context.colorspace = colors.Colorspace.ITU709
                context.color_range = colors.ColorRange.MPEG
            for frame in chain([first], rest):
                if frame.shape != first.shape:
                    raise StyleSplatError(
                        f"Cannot write {path}: the frames differ in size. Write them into a "
                        "folder, or take a round trip (--views orbit)."
                    )
                container.mux(stream.encode(_video_frame(frame, codec)))
            container.mux(stream.encode())


def _video_frame(frame: UInt8[Tensor, "H W C"], codec: _Codec) -> "av.VideoFrame":
    height, width, colors = frame.shape
    if codec.pixels == "bgra":
        pixels = frame.contiguous().cpu().numpy()
        layout = "rgba" if colors == 4 else "rgb24"
        return av.VideoFrame.from_ndarray(pixels, format=layout).reformat(format="bgra")
    pixels = frame[: height // 2 * 2, : width // 2 * 2].contiguous().cpu().numpy()
    reformatter = av.video.reformatter
    return av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
        format="yuv420p",
        dst_colorspace=reformatter.Colorspace.ITU709,
        dst_color_range=reformatter.ColorRange.MPEG,
        interpolation=smooth_color(),
    )


TIFF, PNG, WEBP = (".tif", ".tiff"), ".png", ".webp"
VIDEO_COLORS = (PNG, ".jpg", ".jpeg", WEBP)  # one picture; several make WebP an animation
WITH_ALPHA = (PNG, WEBP)
# Suffixes of files, which nobody wants as the name of a folder
FOREIGN = (
    *(".apng", ".exr", ".flv", ".hdr", ".jxl", ".ksplat", ".npy", ".npz", ".obj", ".ogv", ".ts"),
    *(".7z", ".csv", ".gz", ".html", ".json", ".md", ".mpeg", ".pdf", ".psd", ".rar", ".svg"),
    *(".tar", ".txt", ".usd", ".usdz", ".yaml", ".yml", ".zip", *SPLATS, *PHOTOS, *VIDEOS),
)


def png_names(names: Sequence[str], suffix: str = PNG) -> list[str]:
    """The photos' names with another suffix; where two would be equal, the old suffix stays.

    Example:
        >>> png_names(["cam0/1.jpg", "cam1/1.jpg", "a.jpg", "a.png", "../b.jpg"])
        ['cam0/1.png', 'cam1/1.png', 'a.jpg.png', 'a.png.png', '_/b.png']
    """
    pairs = []
    for name in names:
        path = PurePosixPath(name)
        parts = path.parts[1:] if path.is_absolute() else path.parts
        path = PurePosixPath(*("_" if part == ".." else part for part in parts or ("_",)))
        pairs.append((path.with_suffix(suffix).as_posix(), f"{path.as_posix()}{suffix}"))
    wanted = Counter(name for pair in pairs for name in {*pair})
    return [short if wanted[short] == 1 else long for short, long in pairs]


def refuse_taken(output: Path, *, overwrite: bool) -> None:
    """Raise a StyleSplatError unless `write_views` can write here; ask before the work."""
    suffix = output.suffix.lower()
    if suffix in FOREIGN and not _is_file(output) and not output.is_dir():
        raise StyleSplatError(
            f"Cannot render into {output}: {suffix} is not among the formats. Use "
            f"{', '.join(CODECS)} for a video, {', '.join((*VIDEO_COLORS, *TIFF))} for one "
            "picture, or the name of a folder."
        )
    if not _is_file(output):
        refuse_occupied(output, marker="", overwrite=overwrite)
    else:
        refuse_file(output, overwrite=overwrite)


def write_views(
    names: Sequence[str],
    pictures: Iterable[ViewPicture],
    output: Path,
    *,
    overwrite: bool = False,
    fps: float | int | None = None,
) -> None:
    """Write each view under the photo's name, sub-folders kept; or all as a video; or one picture.

    In a folder colours and ids become PNGs and depths in world units TIFFs. `pictures` are images,
    label ids or depths and are taken one by one. `fps` is by default 30.
    """
    moving = is_video(output, len(names))
    if fps is not None and not moving:
        raise StyleSplatError(f"{output} has no frames a second. Leave --fps out, or name a video.")
    if not moving and output.suffix.lower() in (*VIDEO_COLORS, *TIFF) and len(names) != 1:
        raise StyleSplatError(
            f"{output} is one picture, and there are {len(names)} views. Choose one with "
            "--view NAME, or name a folder."
        )
    rest = iter(pictures)
    first = next(rest, None)
    if first is not None:
        _refuse_unfit(first, output)
        rest = chain([first], rest)
    if _is_file(output):
        with locked_folder(output):
            if moving:
                write_video(rest, output, fps=fps or 30)
            else:
                for picture in rest:
                    _write_picture(picture, output)
        return
    with atomic_folder(output, overwrite=overwrite, marker="") as folder:
        suffix = TIFF[0] if first is not None and first.is_floating_point() else PNG
        for name, picture in zip(png_names(names, suffix), rest, strict=True):
            _write_picture(picture, resolve_within(folder, name))


def is_video(output: Path, count: int) -> bool:
    """Whether `count` views are written as a video or an animation."""
    suffix = output.suffix.lower()
    return suffix in CODECS and (suffix != WEBP or count != 1)


def _is_file(output: Path) -> bool:
    return output.suffix.lower() in (*CODECS, *VIDEO_COLORS, *TIFF)


def _refuse_unfit(picture: ViewPicture, output: Path) -> None:
    suffix = output.suffix.lower()
    colors, transparent = picture.ndim == 3, picture.ndim == 3 and picture.shape[-1] == 4
    if transparent and _is_file(output) and suffix not in WITH_ALPHA:
        raise StyleSplatError(
            f"{suffix} has no transparency here. Choose a --background, such as white, or write "
            "a folder, a .png or a .webp."
        )
    wanted = TIFF if picture.is_floating_point() else (PNG,)
    if not colors and _is_file(output) and suffix not in wanted:
        what = "Depths in world units" if wanted == TIFF else "Label ids"
        raise StyleSplatError(
            f"{what} go into {wanted[0]} files, not into {suffix}. Name a folder or a {wanted[0]}, "
            "or choose depth or label-colors, which are colours."
        )
    if colors and suffix in TIFF:
        raise StyleSplatError(f"{suffix} is for depth-float. Write colours into a .png.")


def _write_picture(picture: ViewPicture, path: Path) -> None:
    if picture.ndim == 3:
        write_image(picture, path)
    elif picture.is_floating_point():
        write_numbers(picture, path)
    else:
        write_label_map(picture, path)
