import os
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest
import torch

import stylesplat as ss
from stylesplat.errors import StyleSplatError
from stylesplat.io.renders import write_video

COLORS = ((200, 60, 30), (20, 160, 230), (240, 240, 240))


def frame(color: tuple[int, int, int], height: int = 36, width: int = 50) -> torch.Tensor:
    return torch.tensor(color, dtype=torch.uint8).expand(height, width, 3).clone()


@pytest.mark.parametrize(
    ("suffix", "container", "codec", "size"),
    [
        (".mp4", "mp4", "h264", (36, 50)),
        (".mov", "mov", "h264", (37, 51)),
        (".MKV", "matroska", "h264", (36, 50)),
        (".webm", "matroska", "vp9", (36, 50)),
    ],
)
def test_frames_come_back_in_order_and_colour(
    tmp_path: Path, suffix: str, container: str, codec: str, size: tuple[int, int]
):
    write_video((frame(color, *size) for color in COLORS), tmp_path / f"a{suffix}", fps=10)
    with av.open(tmp_path / f"a{suffix}") as video:
        stream = video.streams.video[0]
        assert container in video.format.name and stream.average_rate == 10
        assert (stream.codec_context.name, stream.pix_fmt) == (codec, "yuv420p")
        found = [f.to_ndarray(format="rgb24") for f in video.decode(stream)]
    assert len(found) == len(COLORS)
    for image, color in zip(found, COLORS, strict=True):
        assert image.shape == (36, 50, 3)
        # YUV of limited range has about half as many levels as RGB
        np.testing.assert_allclose(image.mean((0, 1)), color, atol=4)


@pytest.mark.parametrize("frames", [[], [torch.zeros(1, 50, 3, dtype=torch.uint8)]])
def test_nothing_to_show(tmp_path: Path, frames: list[torch.Tensor]):
    with pytest.raises(StyleSplatError, match="needs frames of 2x2 pixels or more"):
        write_video(frames, tmp_path / "a.mp4")


WITHOUT_AV = """
import sys
sys.modules["av"] = None  # so that importing it fails
import stylesplat as ss
from stylesplat.demo.demo_run import run_demo
print(*(callable(each) for each in (ss.load, ss.train, ss.stylize, run_demo)))
"""


def test_what_touches_no_video_needs_no_library_of_videos():
    environment = {**os.environ, "PYTHONPATH": str(Path(ss.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_AV], env=environment, capture_output=True, text=True
    )
    assert done.stdout.split() == 4 * ["True"], done.stderr
