"""The checks of a GPU, on the stand-in of one."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gpu
import pytest
import torch

from balls import PAINTED_FAST, TRAINED, write_pictures
from capture_files import write_ball_capture, write_cut_outs
from fake_cuda import cuda  # noqa: F401  (a fixture)
from stylesplat.io.captures.capture_folder import load


@pytest.mark.usefixtures("cuda")
def test_images_and_gradients_are_the_references(capsys: pytest.CaptureFixture[str]):
    assert gpu.check_correctness("cuda")
    assert capsys.readouterr().out.count("ok\n") == 8


@pytest.mark.usefixtures("cuda", "quick_painting")
def test_what_is_timed_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """With few steps; of `main` this leaves out its options."""
    fox = load(write_ball_capture(tmp_path / "balls"))
    assert gpu.frame_rate(100, frames=1) > 0
    monkeypatch.setattr(gpu, "STEPS", 1)
    assert min(gpu.gradient_time(50, (64, 36), features) for features in (0, 16)) > 0
    scene, seconds = gpu.train_fox(fox, steps=20)
    assert seconds > 0 and scene.splats.classifier is not None
    lego = load(write_cut_outs(tmp_path / "cut-outs"))
    assert gpu.train_lego(lego, steps=20) > 0
    assert gpu.lift_labels(scene, fox) > 0
    assert gpu.train_as_paper(fox, steps=4) > 0
    assert gpu.milliseconds(gpu.step_of_colors(fox, scene.splats), 2) > 0
    style, _ = write_pictures(tmp_path)
    quick = replace(PAINTED_FAST, quality="draft", steps=2)
    assert gpu.paint_fox(TRAINED, style, "compact", None, quick) > 0


@pytest.mark.usefixtures("cuda")
def test_rows_are_printed_at_once_and_one_that_fails_does_not_lose_the_others(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    for name in ("reset_peak_memory_stats", "max_memory_allocated"):
        monkeypatch.setattr(torch.cuda, name, lambda: 2**30)
    table = gpu.Table()
    table.row("fox, a step of colours, ms", lambda: 9.0)
    (row,) = capsys.readouterr().out.splitlines()
    assert row.split()[-5:] == ["4.5", "9.0", "2.00", "1.00", "GiB"]

    def fail() -> float:
        raise RuntimeError("no kernel image")

    table.row("fox, 7000 steps, s", fail)
    assert "no kernel image" in capsys.readouterr().out
    table.row("the same with 16 identities, ms", lambda: 3.0, "gsplat")
    assert capsys.readouterr().out.split()[-3:] == ["3.0", "1.00", "GiB"]
    assert table.missing == ["fox, 7000 steps, s"]


def test_av_is_imported_where_a_video_is_read_alone():
    """The machine with the GPU may have none."""
    code = """import sys, gpu
gpu.install(None)
import stylesplat.verbs.train, stylesplat.verbs.stylize, stylesplat.io.renders
assert 'av' not in sys.modules"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=gpu.ROOT / "benchmarks", capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
