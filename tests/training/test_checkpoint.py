"""Checkpoints that cannot be written cost a line, and nothing else."""

import os
import signal
import subprocess
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import pytest
import torch

from processes import no_room
from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.scene.capture import Capture, fingerprint
from stylesplat.scene.splats import Classifier
from stylesplat.training.checkpoint import (
    Checkpoint,
    Checkpointer,
    load_checkpoint,
    save_checkpoint,
)
from stylesplat.training.loop import fit
from stylesplat.training.state import State, first_state
from stylesplat.training.train_config import TrainConfig

REMEDY = "The same settings and photos continue it; `--restart` begins anew."


@pytest.fixture
def place(tmp_path: Path) -> Checkpoint:
    return Checkpoint(tmp_path / "checkpoint.pt", TrainConfig(steps=9), MARK)


def state(step: int = 4) -> State:
    classifier = Classifier(torch.ones(2, 16), torch.zeros(2), (0, 3))
    begun = first_state(replace(random_splats(20), classifier=classifier))
    for name, tensor in begun.moments.first.items():
        tensor += torch.randn(tensor.shape, generator=torch.Generator().manual_seed(len(name)))
    return replace(begun, step=step, seconds=1.5)


def stopped_at(step: int):
    def stop(state: State, loss: float, psnr: float) -> None:
        if state.step == step:
            signal.raise_signal(signal.SIGINT)

    return stop


def assert_equal(one: State, other: State) -> None:
    for name, tensor in one.params.items():
        assert torch.equal(tensor, other.params[name]), name
        assert torch.equal(one.moments.first[name], other.moments.first[name]), name
        assert torch.equal(one.moments.second[name], other.moments.second[name]), name


def test_what_is_loaded_is_what_was_saved(place: Checkpoint):
    before = state()
    save_checkpoint(place, before)
    after = load_checkpoint(place, CPU)
    assert_equal(before, after)
    assert (after.step, after.seconds, after.ids) == (4, 1.5, (0, 3))
    assert after.first_count == before.first_count
    assert all(tensor.requires_grad for tensor in after.params.values())


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"seed": 5}, "a run with another seed"),
        ({"steps": 10, "max_gaussians": 7}, "a run with another steps, max_gaussians"),
        ({"max_seconds": 3.0}, "a run with another max_seconds"),
        ({"coarse_to_fine": False}, "a run with another coarse_to_fine"),
    ],
)
def test_other_settings_are_named(place: Checkpoint, settings: dict, told: str):
    save_checkpoint(place, state())
    other = replace(place, config=replace(place.config, **settings))
    with pytest.raises(StyleSplatError) as caught:
        load_checkpoint(other, CPU)
    assert str(caught.value) == f"Cannot continue from {place.path}: it is of {told}. {REMEDY}"


def test_every_setting_but_those_of_memory_counts(place: Checkpoint):
    other = {
        name: (not value) if isinstance(value, bool) else (value or 0) + 1
        for name, value in asdict(place.config).items()
        if not isinstance(value, str)
    }
    other["color_correction"] = "on"
    other["object_pixels"] = other["max_seconds"] = other["max_memory"] = 1.0
    other["sh_degree"] = 2  # there is none above 3
    for name, value in other.items():
        config = replace(place.config, **{name: value})
        save_checkpoint(replace(place, config=config), state())
        if name == "max_memory":
            load_checkpoint(place, CPU)
            continue
        with pytest.raises(StyleSplatError, match=f"another {name}\\."):
            load_checkpoint(place, CPU)


def test_settings_that_an_older_version_did_not_have_are_the_defaults(place: Checkpoint):
    save_checkpoint(place, state())
    content = torch.load(place.path, weights_only=True)
    del content["config"]["refine_end"]
    torch.save(content, place.path)
    assert load_checkpoint(place, CPU).step == 4
    with pytest.raises(StyleSplatError, match="another refine_end"):
        load_checkpoint(replace(place, config=replace(place.config, refine_end=0.5)), CPU)


@pytest.mark.parametrize(
    ("part", "told"),
    [
        ("size=2", "photos of another size"),
        ("poses=3", "other poses"),
        ("labels=5", "other label maps"),
        ("photos=7", "photos with other content"),
    ],
)
def test_other_captures_are_named(place: Checkpoint, part: str, told: str):
    save_checkpoint(place, state())
    other = replace(place, capture=MARK.replace(part, f"{part}0"))
    with pytest.raises(StyleSplatError, match=f"it is of {told}. {REMEDY}"):
        load_checkpoint(other, CPU)


def test_checkpoints_that_do_not_know_their_capture_are_refused(place: Checkpoint):
    save_checkpoint(place, state())
    content = torch.load(place.path, weights_only=True)
    del content["capture"]
    torch.save(content, place.path)
    with pytest.raises(StyleSplatError, match=f"older version, .*photos, poses, .*{REMEDY}"):
        load_checkpoint(place, CPU)


@pytest.mark.parametrize("content", [b"", b"nonsense", "half", "other"])
def test_what_is_no_checkpoint_is_refused(place: Checkpoint, content):
    save_checkpoint(place, state())
    if content == "half":
        content = place.path.read_bytes()[:1000]
    if content == "other":
        torch.save({"config": {}, "capture": MARK}, place.path)
    else:
        place.path.write_bytes(content)
    with pytest.raises(StyleSplatError, match=r"Cannot continue from .*--restart"):
        load_checkpoint(place, CPU)


def put(*keys: str | int, value: object) -> Callable[[dict], None]:
    """Change one thing deep in the content of a checkpoint."""

    def change(content: dict) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


def lacking(*keys: str) -> Callable[[dict], None]:
    def change(content: dict) -> None:
        for key in keys[:-1]:
            content = content[key]
        del content[keys[-1]]

    return change


@pytest.mark.parametrize(
    "change",
    [
        *(lacking(key) for key in ("params", "first", "second", "ids", "counts", "seconds")),
        *(lacking(key, "means") for key in ("params", "first", "second")),
        lacking("params", "weight"),
        put("params", value={}),
        put("params", "means", value=torch.zeros(20, 4)),
        put("params", "means", value=torch.zeros(19, 3)),
        put("params", "means", value=torch.zeros(20, 3).double()),
        put("params", "means", value=torch.full((20, 3), torch.nan)),
        put("params", "means", value=[[0.0] * 3] * 20),
        put("params", "means", value=torch.zeros(1, 1).expand(2**40, 3)),
        put("params", "shN", value=torch.zeros(20, 8, 3)),
        put("params", "more", value=torch.zeros(20, 3)),
        put("first", "quats", value=torch.zeros(20, 3)),
        put("first", "quats", value=torch.full((20, 4), torch.inf)),
        put("second", "sh0", value=torch.full((20, 1, 3), -1.0)),
        put("second", value=3),
        put("ids", value=[0]),
        put("ids", value=[0, 0]),
        put("ids", value=[]),
        put("ids", value=[0, 2**24]),
        put("ids", value=["a", "b"]),
        put("params", "color_maps", value=torch.zeros(9, 3, 4)),
        put("counts", value=[20]),
        put("counts", value=[20, -1]),
        put("counts", value=[20, 2.5]),
        put("seconds", value=float("nan")),
        put("seconds", value=-1.0),
    ],
)
def test_checkpoints_that_cannot_be_continued_are_refused(
    place: Checkpoint, change: Callable[[dict], None]
):
    save_checkpoint(place, state())
    content = torch.load(place.path, weights_only=True)
    change(content)
    torch.save(content, place.path)
    with pytest.raises(StyleSplatError, match=r"Cannot continue from .*checkpoint\.pt: it is not"):
        load_checkpoint(place, CPU)


def test_checkpoints_that_unpack_to_more_are_refused(place: Checkpoint, tmp_path: Path):
    save_checkpoint(place, state())
    with ZipFile(place.path) as packed:
        parts = {name: packed.read(name) for name in packed.namelist()}
    largest = max(parts, key=lambda name: len(parts[name]))
    with ZipFile(place.path, "w", ZIP_DEFLATED) as packed:
        for name, part in parts.items():
            packed.writestr(name, part if name != largest else b"\0" * 10**6)
    with pytest.raises(StyleSplatError, match="it is not a checkpoint, or damaged") as caught:
        load_checkpoint(place, CPU)
    assert "more than it does" in str(caught.value.__cause__)


def test_refusing_leaves_the_folder_as_it_is(capture: Capture, config, tmp_path: Path):
    path, other = tmp_path / "checkpoint.pt", tmp_path / ".checkpoint.0123456789ab.pt"
    path.write_bytes(b"something")
    other.write_bytes(b"else")
    with pytest.raises(StyleSplatError, match="Cannot continue"):
        fit(capture, config, checkpoint=path)
    assert path.read_bytes() == b"something" and other.read_bytes() == b"else"


@pytest.mark.parametrize("joint", [True, False], ids=["joint", "colour"])
def test_interrupted_and_continued_is_the_straight_run(
    capture: Capture, config: TrainConfig, tmp_path: Path, joint: bool
):
    photos = capture if joint else replace(capture, label_maps=None)
    path = tmp_path / "new folder" / "checkpoint.pt"
    with pytest.raises(KeyboardInterrupt):
        fit(photos, config, checkpoint=path, on_progress=stopped_at(30))
    continued = fit(photos, config, checkpoint=path)
    straight = fit(photos, config)
    assert continued.step == straight.step == config.steps
    assert ("identities" in straight.params) == joint
    assert_equal(continued, straight)


def test_continuing_says_so(capture: Capture, config: TrainConfig, tmp_path: Path, said: list):
    path = tmp_path / "checkpoint.pt"
    with pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=path, on_progress=stopped_at(10))
    assert said == []
    fit(capture, config, checkpoint=path)
    assert said == [f"Continuing from {path}, after 10 steps. `--restart` begins anew."]


def test_a_finished_run_can_be_continued(capture: Capture, config: TrainConfig, tmp_path: Path):
    path = tmp_path / "checkpoint.pt"
    with pytest.raises(StyleSplatError, match="Cannot finish"):
        fit(capture, config, checkpoint=path, finish=True)
    with pytest.raises(StyleSplatError, match="no checkpoint is given"):
        fit(capture, config, finish=True)
    with pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=path, on_progress=stopped_at(10))
    shorter = replace(config, steps=10)
    ended = [
        fit(capture, shorter, checkpoint=path),
        fit(capture, replace(shorter, max_seconds=1e6), checkpoint=path, finish=True),
    ]
    for state in ended:
        assert state.step == 10
        assert_equal(state, load_checkpoint(Checkpoint(path, shorter, fingerprint(capture)), CPU))
    assert_equal(fit(capture, config, checkpoint=path), fit(capture, config))


def test_a_run_that_took_fewer_steps_is_not_over(
    capture: Capture, config: TrainConfig, tmp_path: Path
):
    path = tmp_path / "checkpoint.pt"
    with pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=path, on_progress=stopped_at(10))
    for settings in ({"steps": 11}, {"max_seconds": 1e6}):
        with pytest.raises(StyleSplatError, match=f"another {next(iter(settings))}"):
            fit(capture, replace(config, **settings), checkpoint=path)


def test_a_run_of_other_photos_is_refused(capture: Capture, config: TrainConfig, tmp_path: Path):
    path = tmp_path / "checkpoint.pt"
    with pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=path, on_progress=stopped_at(10))
    cameras = capture.cameras.downscale(2)
    small = replace(
        capture,
        cameras=cameras,
        photos=[photo[::2, ::2].contiguous() for photo in capture.photos],
        label_maps=None,
    )
    unlabelled = replace(capture, label_maps=None)
    turned = replace(capture, photos=[255 - photo for photo in capture.photos])
    for other, told in (
        (small, "photos of another size"),
        (unlabelled, "other label maps"),
        (turned, "photos with other content"),
    ):
        with pytest.raises(StyleSplatError, match=told):
            fit(other, config, checkpoint=path)
    assert fit(capture, config, checkpoint=path).step == config.steps


def test_a_moved_capture_and_another_memory_continue(
    capture: Capture, config: TrainConfig, tmp_path: Path
):
    path = tmp_path / "checkpoint.pt"
    with pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=path, on_progress=stopped_at(10))
    moved = replace(capture, path=tmp_path)
    assert fingerprint(moved) == fingerprint(capture)
    continued = fit(moved, replace(config, max_memory=0.0), checkpoint=path)
    assert_equal(continued, fit(capture, config))


CPU = torch.device("cpu")
MARK = "names=1 size=2 poses=3 points=4 labels=5 objects=6 photos=7"


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint after each step."""
    monkeypatch.setattr("stylesplat.training.checkpoint.CHECKPOINT_SECONDS", -1.0)


def test_a_checkpoint_that_has_no_room_leaves_the_last_one(place: Checkpoint):
    save_checkpoint(place, state())
    with no_room(), pytest.raises(StyleSplatError, match=r"Cannot write .*: File too large\."):
        save_checkpoint(place, state(step=5))
    assert [*place.path.parent.iterdir()] == [place.path]
    assert load_checkpoint(place, CPU).step == 4


def test_a_full_disk_is_called_so(tmp_path: Path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk]
    if os.getuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("cannot mount a small disk here")
    place = Checkpoint(disk / "checkpoint.pt", TrainConfig(), MARK)
    try:
        save_checkpoint(place, state())
        (disk / "other").write_bytes(bytes(disk_left(disk)))
        with pytest.raises(StyleSplatError, match="disk full"):
            save_checkpoint(place, state(step=5))
        assert load_checkpoint(place, CPU).step == 4
    finally:
        subprocess.run(["umount", disk], check=True)


def disk_left(disk: Path) -> int:
    room = os.statvfs(disk)
    return room.f_bavail * room.f_frsize


def test_torch_without_a_reason(place: Checkpoint, monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object) -> None:
        raise RuntimeError("[enforce fail at inline_container.cc:671] . unexpected pos 1\nframe")

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(StyleSplatError, match=r"Cannot write .*unexpected pos 1\.$"):
        save_checkpoint(place, state())


def test_said_once_and_when_it_works_again(place: Checkpoint, said: list[str], often: None):
    checkpointer = Checkpointer(place, state())
    with no_room():
        checkpointer.after_step(state())
        checkpointer.after_step(state())
    (line,) = said
    assert "File too large" in line and line.endswith("Training goes on without a checkpoint.")
    checkpointer.after_step(state())
    checkpointer.after_step(state())
    assert said[1:] == ["Checkpoints can be written again."]


def test_the_run_goes_on_without_and_has_its_result(
    capture: Capture, config: TrainConfig, tmp_path: Path, said: list[str], often: None
):
    checkpoint = tmp_path / "checkpoint.pt"
    with no_room():
        found = fit(capture, config, checkpoint=checkpoint)
    assert found.step == config.steps
    assert sum(line.startswith("Cannot write") for line in said) == 1
    assert not checkpoint.exists()


def test_an_interrupted_run_that_is_not_kept_says_so(
    capture: Capture, config: TrainConfig, tmp_path: Path, said: list[str]
):
    config, checkpoint = replace(config, photos_at_once=1), tmp_path / "checkpoint.pt"

    def stop_at(step: int):
        def stop(state: State, loss: float, psnr: float) -> None:
            if state.step == step:
                signal.raise_signal(signal.SIGINT)

        return stop

    with no_room(), pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=checkpoint, on_progress=stop_at(2))
    assert said[-1].endswith("There is no checkpoint, and the run was at step 2.")
    with pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=checkpoint, on_progress=stop_at(3))
    with no_room(), pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=checkpoint, on_progress=stop_at(5))
    assert said[-1].endswith("The last checkpoint is of step 3, and the run was at step 5.")
