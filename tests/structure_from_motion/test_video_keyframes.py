import re
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from capture_files import film, view
from stylesplat.errors import StyleSplatError
from stylesplat.structure_from_motion.prepare import prepare
from stylesplat.structure_from_motion.video_keyframes import FrameInfo, pick_keyframes


def numbers(names: tuple[str, ...]) -> list[int]:
    return [int(re.sub(r"\D", "", name)) for name in names]


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def test_frames_lie_at_even_motion_and_are_sharp(tmp_path: Path):
    steps = np.r_[np.full(40, 2.0), np.full(20, 10.0), np.zeros(20)]  # slow, fast, still
    places = np.cumsum(steps)
    frames = [view(x, blur=9 * (i % 2)) for i, x in enumerate(places)]
    video = film(tmp_path / "walk.mp4", frames)
    prepared = prepare(video, tmp_path / "out", frames=12)
    chosen = numbers(prepared.names)
    assert prepared.ordered
    assert 10 <= len(chosen) <= 12
    assert all(number % 2 == 0 for number in chosen)  # the others are blurred
    moved = np.diff(places[chosen])
    assert moved.max() <= 45 and moved.min() >= 10, moved  # 23 each, were it exact
    name, number = prepared.names[3], chosen[3]
    assert prepared.origins[name] == f"frame {number} at {number / 30:.2f} s"
    difference = (pixels(tmp_path / "out" / name) - frames[number].astype(int)).mean(axis=2)
    assert np.abs(difference).mean() < 6  # H.264 and JPEG


def test_a_camera_that_moves_little_gives_fewer_frames(tmp_path: Path):
    video = film(tmp_path / "a.mp4", [view(i * 0.5) for i in range(60)])  # 9 % of the width
    assert 4 <= len(prepare(video, tmp_path / "out").names) <= 8
    # A part of the path without frames is skipped
    path = [0.0, 0.15, 0.25, 0.85, 1.0]
    jump = [FrameInfo(i, i / 30, travel, 1.0) for i, travel in enumerate(path)]
    assert [frame.number for frame in pick_keyframes(jump, 10)] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("degrees", [90, -90, 180])
def test_rotation_is_honoured(tmp_path: Path, degrees: int):
    frames = [view(i * 8) for i in range(12)]
    video = film(tmp_path / "a.mov", frames, lambda stream: stream.set_display_rotation(degrees))
    name = prepare(video, tmp_path / "out").names[0]
    upright = np.rot90(frames[numbers((name,))[0]], degrees // 90)
    written = pixels(tmp_path / "out" / name)
    assert written.shape == upright.shape
    assert np.abs(written - upright).mean() < 12  # colours of H.264 have half the size


def test_broken_packets_are_skipped(tmp_path: Path):
    video = film(tmp_path / "a.avi", [view(i * 8) for i in range(40)], codec="mpeg4")
    content = bytearray(video.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 3000] = bytes(3000)
    video.write_bytes(content)
    assert len(prepare(video, tmp_path / "out", frames=20).names) >= 10


def test_a_killed_call_writes_only_what_is_missing(tmp_path: Path):
    (tmp_path / "in").mkdir()
    film(tmp_path / "in" / "a.webm", [view(i * 8) for i in range(12)], codec="libvpx-vp9")
    prepared = prepare(tmp_path / "in", tmp_path / "out")  # a folder of one video
    gone, kept = (tmp_path / "out" / name for name in prepared.names[:2])
    before, content = kept.stat(), gone.read_bytes()
    gone.unlink()
    assert prepare(tmp_path / "in", tmp_path / "out") == prepared
    assert kept.stat() == before
    assert gone.read_bytes() == content


def test_videos_that_are_of_no_use(tmp_path: Path):
    sound = tmp_path / "sound.mp4"
    with av.open(sound, "w") as container:
        stream = container.add_stream("aac", rate=44100)
        silence = av.AudioFrame.from_ndarray(np.zeros((1, 4410), np.float32), "fltp", "mono")
        silence.sample_rate = 44100
        container.mux(stream.encode(silence))
        container.mux(stream.encode())
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "list.m3u8").write_text("#EXTM3U\n#EXTINF:1,\none.mp4\n#EXT-X-ENDLIST\n")
    flat = np.full_like(view(0), 128)
    cases = {
        sound: "no pictures, only sound",
        tmp_path / "text.mp4": "no video that can be decoded",
        tmp_path / "list.m3u8": "no video that can be decoded",
        film(tmp_path / "one.mp4", [view(0)]): "has 1 frame that can be decoded",
        film(tmp_path / "still.mp4", [view(0)] * 12): "hardly moves",
        film(tmp_path / "flat.mp4", [flat] * 12): "all blurred",
    }
    for video, message in cases.items():
        with pytest.raises(StyleSplatError, match=message):
            prepare(video, tmp_path / "out")
    assert not (tmp_path / "out").exists()
