"""The verb `train`: a scene, and runs that are interrupted."""

import json
import re
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

import stylesplat as ss
from balls import CAMERAS
from capture_files import sfm_record, write_ball_capture
from processes import complaint, result, run
from stylesplat.cli.train import Train
from stylesplat.io.captures.capture_folder import write_sfm
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit

STOP = 5  # steps after which Ctrl-C is pressed


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch):
    """Run a command, and press Ctrl-C in the middle of its training."""

    def interrupted(*arguments: object) -> None:
        def stop(state, *_: object) -> None:
            if state.step >= STOP:
                signal.raise_signal(signal.SIGINT)

        with monkeypatch.context() as patch:
            patch.setattr(
                "stylesplat.verbs.train.fit",
                lambda *args, **options: fit(*args, on_progress=stop, **options),
            )
            assert run(*arguments) == 130

    return interrupted


def test_train_writes_a_scene(capture: Path, tmp_path: Path, capsys):
    out = tmp_path / "scene"
    metrics = result(capsys, "train", capture, "-o", out, "--steps", 40, "--device", "cpu")
    saved = json.loads((out / "metrics.json").read_text())
    assert metrics == {**metrics, **saved}
    assert {"psnr", "ssim", "seconds", "steps", "gaussians", "steps_per_second"} <= set(metrics)
    assert metrics["steps"] == 40
    scene = ss.open(out)
    assert len(scene.splats) == metrics["gaussians"]
    assert scene.splats.classifier is not None
    assert scene.splats.classifier.ids == (0, 3, 7, 300)
    assert scene.info["settings"]["segment"] == "lift" and scene.held_out == ("0000.jpg",)
    assert torch.allclose(scene.cameras.viewmats, CAMERAS.viewmats, atol=1e-6)
    assert [*tmp_path.iterdir()] == [out], "nothing is left beside it"


@pytest.mark.parametrize(
    ("psnr", "trained", "steps", "gaussians", "photos", "verdict"),
    [
        (31.0, 40.0, 40, 5, 12, "That is good.$"),
        (22.3, 23.5, 40, 5, 12, "fair: .*[Tt]rain longer.*--steps 5000"),
        (22.3, 29.8, 40, 5, 12, "fair: .*29.8 dB.*these 12"),
        (18.0, 29.8, 9000, 5, 90, "poor: .*29.8 dB.*--refine-poses.*`stylesplat check photos`"),
        (18.0, 19.0, 9000, 100_000, 90, "poor: .*--max-gaussians 200000"),
        (18.0, 19.0, 9000, 5, 90, "poor: .*`stylesplat check photos`"),
    ],
)
def test_the_advice_follows_from_what_happened(
    psnr: float, trained: float, steps: int, gaussians: int, photos: int, verdict: str
):
    found = {"psnr": psnr, "train_psnr": trained, "steps": steps, "gaussians": gaussians}
    lines = Train(Path("photos"), Path("scene")).outcome(found, TrainConfig(), photos)
    assert f"{psnr} dB from" in next(lines) and re.search(verdict, next(lines))
    whole = {"psnr": psnr + 9, "train_psnr": trained + 9, "steps": steps, "gaussians": gaussians}
    found = whole | {"object_psnr": psnr, "train_object_psnr": trained}
    lines = Train(Path("photos"), Path("scene")).outcome(found, TrainConfig(), photos)
    assert f"{psnr} dB over the object from" in next(lines) and re.search(verdict, next(lines))


def test_runs_limited_by_time_tell_of_a_busy_machine(
    capture: Path, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("os.getloadavg", lambda: (1000.0, 0.0, 0.0), raising=False)
    command = ("train", capture, "--device", "cpu", "-o")
    assert run(*command, tmp_path / "timed", "--max-seconds", 1, "--max-gaussians", 300) == 0
    assert "busy (load 1000" in capsys.readouterr().err
    assert run(*command, tmp_path / "counted", "--steps", 4) == 0
    assert "busy" not in capsys.readouterr().err


def test_a_room_that_becomes_a_fog_is_told_with_the_remedy(tmp_path: Path, said: list[str]):
    masked, folder = (
        write_ball_capture(tmp_path / name, masks=name == "masked") for name in ("masked", "plain")
    )
    for each in (masked, folder):
        write_sfm(sfm_record(given=8, registered=8, turns=True), each)
    few: dict[str, Any] = {"steps": 1, "max_gaussians": 300, "device": "cpu"}
    ss.train(ss.load(masked), **few)
    ss.train(ss.load(masked, masks=False), **few)  # as the user wants it
    unmasked = ss.load(folder)
    ss.train(replace(unmasked, path=None), **few)
    assert not any("fog" in line for line in said)
    ss.train(unmasked, **few)
    (line,) = (line for line in said if "fog" in line)
    assert f"`stylesplat mask {folder} --box VIEW:" in line


def test_what_photos_have_of_their_own(capture: Path, tmp_path: Path, capsys):
    out = tmp_path / "scene"
    options = ("--color-correction", "on", "--refine-poses", "--steps", 20, "--device", "cpu")
    metrics = result(capsys, "train", capture, "-o", out, *options)
    scene = ss.open(out)
    assert scene.info["fits"] == ["colors", "pose"]
    assert {"color_maps", "pose_shifts"}.isdisjoint(scene.splats.tensors())
    moved = (scene.cameras.viewmats - CAMERAS.viewmats).abs().amax(dim=(1, 2)) > 1e-5
    assert moved.tolist() == [False] + 7 * [True]
    again = ss.evaluate(scene, ss.load(capture), device="cpu")
    for name in ("psnr", "ssim", "psnr_unfitted", "ssim_unfitted"):
        assert again[name] == pytest.approx(metrics[name], abs=1e-3), name


def test_an_interrupted_run_continues_and_keeps_the_scene_until_then(
    capture: Path, scene: Path, capsys, interrupted
):
    before = {p.name: p.read_bytes() for p in scene.iterdir()}
    command = ("train", capture, "-o", scene, "--steps", 12, "--overwrite")
    interrupted(*command)
    assert {p.name: p.read_bytes() for p in scene.iterdir()} == before
    assert ss.open(scene).metrics == {"psnr": 30.0}, "still readable"
    assert "--overwrite" in complaint(capsys, *command[:-1])
    partial = scene.parent / "scene.partial"
    assert [p.name for p in partial.iterdir()] == ["checkpoint_lift.pt"]
    assert run(*command) == 0
    assert "Continuing" in capsys.readouterr().err
    assert ss.open(scene).metrics["steps"] == 12
    assert [*scene.parent.iterdir()] == [scene], "what was interrupted is done"


def test_photos_are_made_smaller_unless_all_pixels_are_wanted(
    capture: Path, tmp_path: Path, capsys, interrupted, monkeypatch: pytest.MonkeyPatch
):
    measured = iter([2.0])  # once: a run that goes on has the size that it had
    monkeypatch.setattr(
        "stylesplat.training.photo_size.affordable_downscale", lambda *_, **__: next(measured)
    )
    command = ("train", capture, "-o", tmp_path / "scene", "--steps", 12)
    interrupted(*command)
    assert "2 times smaller than they are; `--downscale 1`" in capsys.readouterr().err
    assert run(*command) == 0
    assert "Continuing" in capsys.readouterr().err
    assert ss.open(tmp_path / "scene").downscale == 1, "painted with all pixels of small photos"
    assert run(*command, "--overwrite", "--downscale", 2) == 0
    assert "times smaller" not in capsys.readouterr().err
    assert ss.open(tmp_path / "scene").downscale == 2


def test_restart_begins_anew_and_deletes_what_is_ours_only(
    capture: Path, tmp_path: Path, capsys, interrupted
):
    out, partial = tmp_path / "scene", tmp_path / "scene.partial"
    interrupted("train", capture, "-o", out, "--steps", 60)
    (partial / ".checkpoint_lift.0123456789ab.pt").touch()
    (partial / "notes.txt").write_text("mine")
    # With other settings the run cannot be continued
    other = ("train", capture, "-o", out, "--steps", 30, "--seed", 3)
    assert "another steps, seed" in complaint(capsys, *other)
    assert (partial / "checkpoint_lift.pt").exists()
    command = Train(capture, out, restart=True)
    assert command.after_interruption.startswith("Without `--restart`")
    assert run(*other, "--restart") == 0
    assert "Continuing" not in capsys.readouterr().err
    assert ss.open(out).metrics["steps"] == 30
    assert [path.name for path in partial.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("how", [("--finish", "--max-seconds", 900), ("--steps", 2)])
def test_an_interrupted_run_may_end_where_it_is(
    capture: Path, tmp_path: Path, capsys, interrupted, how: tuple
):
    out = tmp_path / "scene"
    command = ("train", capture, "-o", out, "--device", "cpu")
    interrupted(*command, "--steps", 60)
    assert "--finish" in capsys.readouterr().err
    metrics = result(capsys, *command, *how)
    assert STOP <= metrics["steps"] < 60 and metrics["psnr"] > 0
    scene = ss.open(out)
    assert scene.splats.classifier is not None
    assert scene.splats.classifier.ids == (0, 3, 7, 300), "label maps are lifted as in any run"
    assert [*tmp_path.iterdir()] == [out], "what was interrupted is done"


def test_what_is_wrong_costs_no_checkpoint(capture: Path, tmp_path: Path, capsys):
    checkpoint = tmp_path / "scene.partial" / "checkpoint_lift.pt"
    checkpoint.parent.mkdir()
    checkpoint.write_bytes(b"hours of work")
    assert "checkpoint_lift.pt" in complaint(
        capsys, "train", capture, "-o", tmp_path / "other", "--finish"
    )
    options = ("-o", tmp_path / "scene", "--overwrite", "--restart", "--steps")
    assert "--restart" in complaint(capsys, "train", capture, *options, 1, "--finish")
    complaint(capsys, "train", tmp_path / "typo", *options, 1)
    complaint(capsys, "train", capture, *options, 0)
    damaged = complaint(capsys, "train", capture, "-o", tmp_path / "scene", "--steps", 1)
    assert "Cannot continue" in damaged
    assert checkpoint.read_bytes() == b"hours of work"
