"""The checks of a GPU, on the stand-in of one."""

from dataclasses import replace
from pathlib import Path

import gpu
import pytest

from balls import PAINTED_FAST, TRAINED, write_pictures
from capture_files import write_ball_capture
from fake_cuda import cuda  # noqa: F401  (a fixture)
from stylesplat.io.captures.capture_folder import load


@pytest.mark.usefixtures("cuda")
def test_images_and_gradients_are_the_references(capsys: pytest.CaptureFixture[str]):
    assert gpu.check_correctness("cuda")
    assert capsys.readouterr().out.count("ok\n") == 8


@pytest.mark.usefixtures("cuda", "quick_painting")
def test_what_is_timed_runs(tmp_path: Path):
    """With few steps; of `main` this leaves out its table and options."""
    fox = load(write_ball_capture(tmp_path / "balls"))
    assert gpu.frame_rate(100, frames=1) > 0
    scene, seconds = gpu.train_fox(fox, steps=20)
    assert seconds > 0 and scene.splats.classifier is not None
    assert gpu.train_as_paper(fox, steps=4) > 0
    assert gpu.milliseconds(gpu.step_of_colors(fox, scene.splats), 2) > 0
    style, _ = write_pictures(tmp_path)
    quick = replace(PAINTED_FAST, quality="draft", steps=2)
    assert gpu.paint_fox(TRAINED, style, "compact", None, quick) > 0
