"""A run continues from its checkpoint only; one that cannot be written costs a line."""

from dataclasses import asdict, replace
from pathlib import Path
from unittest.mock import Mock

import pytest
import torch

from processes import interrupt, no_room
from scenes import randn, random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.scene.capture import Capture, fingerprint
from stylesplat.scene.splats import Classifier
from stylesplat.training.checkpoint import (
    Checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit
from stylesplat.training.state import State, first_state

CPU = torch.device("cpu")
MARK = "names=1 size=2 poses=3 points=4 labels=5 objects=6 photos=7"


@pytest.fixture
def place(tmp_path: Path) -> Checkpoint:
    return Checkpoint(tmp_path / "checkpoint.pt", TrainConfig(steps=9), MARK)


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint after each step."""
    monkeypatch.setattr("stylesplat.training.checkpoint.CHECKPOINT_SECONDS", -1.0)


def some_state(step: int = 4) -> State:
    classifier = Classifier(torch.ones(2, 16), torch.zeros(2), (0, 3))
    begun = first_state(replace(random_splats(20), classifier=classifier))
    for name, tensor in begun.moments.first.items():
        tensor += randn(*tensor.shape, seed=len(name))
    remembered = {"grad_norms": torch.arange(20.0), "counts": torch.ones(20)}
    return replace(begun, step=step, seconds=1.5, strategy_state=remembered)


def assert_equal(one: State, other: State) -> None:
    for name, tensor in one.params.items():
        assert torch.equal(tensor, other.params[name]), name
        assert torch.equal(one.moments.first[name], other.moments.first[name]), name
        assert torch.equal(one.moments.second[name], other.moments.second[name]), name
    assert one.strategy_state.keys() == other.strategy_state.keys()
    for name, tensor in one.strategy_state.items():
        assert torch.equal(tensor, other.strategy_state[name]), name


def test_what_is_loaded_is_what_was_saved(place: Checkpoint):
    before = some_state()
    save_checkpoint(place, before)
    after = load_checkpoint(place, CPU)
    assert_equal(before, after)
    assert (after.step, after.seconds, after.ids) == (4, 1.5, (0, 3))
    assert after.first_count == before.first_count
    assert all(tensor.requires_grad for tensor in after.params.values())


@pytest.mark.parametrize(
    ("name", "value"),
    [("means", 1e10), ("means", torch.nan), ("scales", 30.0), ("sh0", torch.inf), ("quats", 0.0)],
)
def test_gaussians_that_ran_away_cost_no_checkpoint(place: Checkpoint, name: str, value: float):
    state = some_state()
    with torch.no_grad():
        state.params[name][3] = value
    state.moments.second["means"][5] = torch.inf
    save_checkpoint(place, state)
    kept = torch.tensor([row not in (3, 5) for row in range(20)])
    loaded = load_checkpoint(place, CPU)
    assert not loaded.strategy_state, "it was of all rows"
    for each in state.names:
        assert torch.equal(loaded.params[each], state.params[each][kept]), each
        assert torch.equal(loaded.moments.first[each], state.moments.first[each][kept]), each


def test_other_settings_but_those_of_memory_are_named(place: Checkpoint):
    other = {
        name: (not value) if isinstance(value, bool) else (value or 0) + 1
        for name, value in asdict(place.config).items()
        if not isinstance(value, str)
    }
    other["color_correction"] = "on"
    other["max_seconds"] = other["max_memory"] = 1.0
    other["sh_degree"] = 2  # there is none above 3
    other["growth_end"] = other["refine_end"] = other["cooldown"] = 0.1  # nor shares above 1
    for name, value in other.items():
        config = replace(place.config, **{name: value})
        save_checkpoint(replace(place, config=config), some_state())
        if name == "max_memory":
            load_checkpoint(place, CPU)
            continue
        with pytest.raises(StyleSplatError, match=f"a run with another {name}\\. .*--restart"):
            load_checkpoint(place, CPU)


def test_settings_that_an_older_version_did_not_have_are_the_defaults(place: Checkpoint):
    save_checkpoint(place, some_state())
    content = torch.load(place.path, weights_only=True)
    del content["config"]["refine_end"], content["strategy"]
    torch.save(content, place.path)
    older = load_checkpoint(place, CPU)
    assert older.step == 4 and not older.strategy_state
    with pytest.raises(StyleSplatError, match="another refine_end"):
        load_checkpoint(replace(place, config=replace(place.config, refine_end=0.5)), CPU)


@pytest.mark.parametrize("content", [b"", b"nonsense", "half"])
def test_what_is_no_checkpoint_is_refused_and_stays(place: Checkpoint, content):
    save_checkpoint(place, some_state())
    before = place.path.read_bytes()[:1000] if content == "half" else content
    place.path.write_bytes(before)
    with pytest.raises(StyleSplatError, match=r"Cannot continue from .*--restart"):
        load_checkpoint(place, CPU)
    assert place.path.read_bytes() == before


@pytest.mark.parametrize(
    "part, name, value",
    [
        *((key, None, None) for key in ("params", "first", "second", "ids", "counts", "seconds")),
        ("params", "weight", None),
        ("second", "means", None),
        ("params", "means", torch.zeros(19, 3)),
        ("params", "means", torch.full((20, 3), torch.nan)),
        ("params", "means", torch.zeros(1, 1).expand(2**40, 3)),
        ("params", "more", torch.zeros(20, 3)),
        ("first", "quats", torch.full((20, 4), torch.inf)),
        ("second", "sh0", torch.full((20, 1, 3), -1.0)),
        ("ids", None, [0]),
        ("params", "color_maps", torch.zeros(9, 3, 4)),
        ("counts", None, [20]),
        ("strategy", "grad_norms", None),
        ("strategy", "grad_norms", torch.zeros(19)),
        ("strategy", "grad_norms", torch.full((20,), -1.0)),
        ("strategy", "more", torch.zeros(20)),
    ],
)
def test_checkpoints_that_cannot_be_continued_are_refused(
    place: Checkpoint, part: str, name: str | None, value: object
):
    save_checkpoint(place, some_state())
    content = torch.load(place.path, weights_only=True)
    changed, key = (content, part) if name is None else (content[part], name)
    changed.pop(key, None)
    if value is not None:
        changed[key] = value
    torch.save(content, place.path)
    with pytest.raises(StyleSplatError, match=r"Cannot continue from .*checkpoint\.pt: it is not"):
        load_checkpoint(place, CPU)


def test_interrupted_and_continued_is_the_straight_run(
    capture: Capture, config: TrainConfig, tmp_path: Path, said: list[str]
):
    path = tmp_path / "new folder" / "checkpoint.pt"
    interrupt(capture, config, path, 30)
    continued = fit(capture, config, checkpoint=path)
    assert said[-1:] == [f"Continuing from {path}, after 30 steps. `--restart` begins anew."]
    straight = fit(capture, config)
    assert continued.step == straight.step == config.steps and "identities" in straight.params
    assert_equal(continued, straight)


def test_an_interrupted_run_can_be_finished_or_continued(
    capture: Capture, config: TrainConfig, tmp_path: Path
):
    path = tmp_path / "checkpoint.pt"
    for given, fact in ((path, "there is no"), (None, "no checkpoint is given")):
        with pytest.raises(StyleSplatError, match=f"Cannot finish a training: {fact}"):
            fit(capture, config, checkpoint=given, finish=True)
    interrupt(capture, config, path, 10)
    shorter = replace(config, steps=10)
    for state in (
        fit(capture, shorter, checkpoint=path),
        fit(capture, replace(shorter, max_seconds=1e6), checkpoint=path, finish=True),
    ):
        assert state.step == 10
        assert_equal(state, load_checkpoint(Checkpoint(path, shorter, fingerprint(capture)), CPU))
    for settings in ({"steps": 11}, {"max_seconds": 1e6}):  # the steps taken do not suffice
        with pytest.raises(StyleSplatError, match=f"another {next(iter(settings))}"):
            fit(capture, replace(config, **settings), checkpoint=path)
    with pytest.raises(StyleSplatError, match="another capture"):
        fit(replace(capture, label_maps=None), config, checkpoint=path)
    moved = replace(capture, path=tmp_path)
    continued = fit(moved, replace(config, max_memory=0.0), checkpoint=path)
    assert_equal(continued, fit(capture, config))


def test_a_checkpoint_that_has_no_room_leaves_the_last_one(
    place: Checkpoint, monkeypatch: pytest.MonkeyPatch
):
    save_checkpoint(place, some_state())
    with no_room(), pytest.raises(StyleSplatError, match=r"Cannot write .*: File too large\."):
        save_checkpoint(place, some_state(step=5))
    assert [*place.path.parent.iterdir()] == [place.path]
    assert load_checkpoint(place, CPU).step == 4
    reason = RuntimeError("[enforce fail at inline_container.cc:671] . unexpected pos 1\nframe")
    monkeypatch.setattr(torch, "save", Mock(side_effect=reason))
    with pytest.raises(StyleSplatError, match=r"Cannot write .*unexpected pos 1\. Choose"):
        save_checkpoint(place, some_state())


def test_a_run_that_cannot_be_saved_goes_on_and_says_so(
    capture: Capture, config: TrainConfig, tmp_path: Path, said: list[str], often: None
):
    config, path = replace(config, photos_at_once=1, steps=20), tmp_path / "checkpoint.pt"
    with no_room():
        assert fit(capture, config, checkpoint=path).step == config.steps
    assert sum(line.startswith("Cannot write") for line in said) == 1 and not path.exists()
    with no_room():
        interrupt(capture, config, path, 2)
    assert said[-1].endswith("The run was at step 2.")
    interrupt(capture, config, path, 3)
    with no_room():
        interrupt(capture, config, path, 5)
    assert said[-1].endswith("The run was at step 5.")
