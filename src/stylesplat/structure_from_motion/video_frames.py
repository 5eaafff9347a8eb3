"""Which frames of a video are fit for structure from motion."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say, task
from stylesplat.structure_from_motion.displacement import Tracker
from stylesplat.structure_from_motion.photo_writing import write_jpeg
from stylesplat.structure_from_motion.prepared import LEAST, Prepared
from stylesplat.structure_from_motion.sharpness import ALL_BLURRED, SIDE, SOFT, relative, sharpness
from stylesplat.structure_from_motion.video_reading import Frame, opened_video

# Of the longer side, between neighbours: less is hardly a new view. In fox and desk half of the
# neighbours are more than 3 % apart
STEP = 0.015
# After so much the way goes on from another frame, so what a hand trembles does not add up
STRIDE = 0.03
LOST = 0.2  # the way to a frame in which nothing is found again
OFF_CENTRE = 0.5  # what a frame's sharpness counts less at the end of its part of the way


@dataclass(frozen=True)
class Seen:
    """A frame at which somebody has looked."""

    number: int
    """Of the frame."""
    time: float
    """Of the frame, in seconds."""
    way: float
    """How far the picture has moved since the start, in longer sides."""
    sharp: float
    """As `sharpness` measures it."""


def choose_frames(path: Path, most: int) -> Prepared:
    """Find sharp frames of a video, equally far apart by what the picture moves.

    Args:
        path: The video.
        most: Frames to choose; if the camera moves little there are fewer.

    Raises:
        StyleSplatError: If it cannot be decoded, has one frame, hardly moves or is all blurred.
    """
    seen = _look_through(path)
    chosen = pick_frames(seen, most)
    _refuse(path, len(seen), chosen)
    sharp = dict(zip(chosen, relative([frame.sharp for frame in chosen]), strict=True))
    kept = {frame_name(frame.number): frame for frame in chosen if sharp[frame] >= SOFT}
    return Prepared(
        names=tuple(kept),
        ordered=True,
        origins={name: _called(frame) for name, frame in kept.items()},
        sharpness={name: sharp[frame] for name, frame in kept.items()},
        left_out={_called(f): "blurred" for f in chosen if frame_name(f.number) not in kept},
    )


def pick_frames(seen: Sequence[Seen], most: int) -> list[Seen]:
    """Of each of so many equal parts of the way the sharpest frame, rather one in its middle.

    Args:
        seen: All frames, in order.
        most: Parts; there are fewer where they would be too short.
    """
    if not seen:
        return []
    length = seen[-1].way - seen[0].way
    parts = max(1, min(most, math.floor(length / STEP) + 1))
    part = length / parts or 1.0
    places = [(frame.way - seen[0].way) / part for frame in seen]
    best: dict[int, tuple[float, Seen]] = {}
    for frame, place in zip(seen, places, strict=True):
        index = min(int(place), parts - 1)
        score = frame.sharp * (1 - OFF_CENTRE * abs(2 * (place - index) - 1))
        if index not in best or score > best[index][0]:
            best[index] = score, frame
    return [frame for _, frame in best.values()]


def write_frames(path: Path, names: Sequence[str], folder: Path) -> None:
    """Write some frames of a video as photos.

    Args:
        path: The video.
        names: What `frame_name` gives for each.
        folder: Where to.

    Raises:
        StyleSplatError: If it cannot be decoded, the disk is full or the place cannot be
            written to.
    """
    missing = {*names}
    if not missing:
        return
    with (
        opened_video(path) as video,
        task("writing frames", len(missing), unit="frame") as bar,
    ):
        for frame in video.frames():
            if (name := frame_name(frame.number)) in missing:
                write_jpeg(frame.upright(video.pixel_width), folder / name)
                missing.remove(name)
                bar.advance()
            if not missing:
                break
    if missing:
        raise StyleSplatError(f"{path} has changed while it was read. Try again.")


def frame_name(number: int) -> str:
    """What the photo of a frame is called.

    Example:
        >>> frame_name(123)
        'frame_000123.jpg'
    """
    return f"frame_{number:06d}.jpg"


def _look_through(path: Path) -> list[Seen]:
    seen: list[Seen] = []
    way = _Way()
    with opened_video(path) as video, task("watching", video.count, unit="frame") as bar:
        for frame in video.frames():
            if not seen and frame.high_range:
                say(f"{path.name} is HDR: its colours are taken as they are, so photos look flat.")
            seen.append(_look(frame, way))
            bar.advance()
    return seen


def _look(frame: Frame, way: "_Way") -> Seen:
    grey = frame.grey(SIDE)
    return Seen(frame.number, frame.time, way.to(grey), sharpness(grey))


def _refuse(path: Path, count: int, chosen: Sequence[Seen]) -> None:
    """Raise a StyleSplatError if nothing can come of the frames that were chosen."""
    if count < LEAST:
        raise StyleSplatError(
            f"{path} has {count or 'no'} frame{'s' * (count != 1)} that can be decoded. Give a "
            "video in which the camera walks around, or a folder of photos."
        )
    if np.median([frame.sharp for frame in chosen]) < ALL_BLURRED:
        raise StyleSplatError(
            f"The frames of {path} are all blurred. Film in more light, and move more slowly."
        )
    if len(chosen) < LEAST:
        raise StyleSplatError(
            f"The camera hardly moves in {path}: {len(chosen)} of its {count} frames differ. "
            "Film while you walk around."
        )


def _called(frame: Seen) -> str:
    """What the user finds it by in a player."""
    time = "" if math.isnan(frame.time) else f" at {frame.time:.2f} s"
    return f"frame {frame.number}{time}"


class _Way:
    """How far the picture has moved since the first frame."""

    def __init__(self) -> None:
        self.tracker: Tracker | None = None
        self.start = 0.0  # where the tracker's frame is
        self.longest = 0.0

    def to(self, grey: np.ndarray) -> float:
        """Where a frame is, in longer sides."""
        moved = self.tracker.to(grey) if self.tracker else 0.0
        self.longest = max(self.longest, self.start + (LOST if moved is None else moved))
        if self.tracker is None or moved is None or moved > STRIDE:
            self.tracker, self.start = Tracker(grey), self.longest
        return self.longest
