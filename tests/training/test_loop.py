import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
import torch

from processes import begun
from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.progress import Silence, observed
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.signals import TAKEN
from stylesplat.training import loop
from stylesplat.training.initialize import first_splats
from stylesplat.training.loop import deferred_interrupt, fit, progress_meter, warm_up_training
from stylesplat.training.state import ALONE, Ranks, Run, State, first_state
from stylesplat.training.step import train_step
from stylesplat.training.train_config import PRESETS, TrainConfig
from stylesplat.training.training_views import split_views


def error(splats: Splats, capture: Capture, row: int) -> float:
    image = rasterize(splats, capture.cameras[row])[0][0]
    return float((image.clamp(0, 1) - capture.photos[row] / 255).square().mean())


def trained(capture: Capture, config: TrainConfig, **settings) -> Splats:
    return fit(capture, replace(config, **settings)).splats.detach()


def test_held_out_views_get_better(capture: Capture, config: TrainConfig):
    generator = torch.Generator().manual_seed(0)
    start = first_splats(capture, sh_degree=3, max_gaussians=400, generator=generator)
    splats = trained(capture, config, steps=150)
    _, held_out = split_views(capture, config.test_every)
    for row in held_out:
        assert error(splats, capture, row) < 0.5 * error(start, capture, row)


def test_the_paper_trains_its_first_thousand_steps_without_higher_bands(capture: Capture):
    splats = trained(capture, PRESETS["paper"], steps=5, max_gaussians=200)
    assert splats.sh_degree == 3 and not splats.shN.any()
    assert trained(capture, TrainConfig(), steps=5, max_gaussians=200).shN.any()


def test_identities_learn_the_labels(capture: Capture, config: TrainConfig):
    splats = trained(capture, config, steps=500, coarse_to_fine=False)
    assert splats.classifier is not None and splats.classifier.ids == (0, 3, 7)
    image = rasterize(splats, capture.cameras[0], features=splats.identities)[0][0, ..., 3:]
    classes = splats.classifier.logits(image).argmax(-1)
    predicted = torch.tensor(splats.classifier.ids)[classes]
    assert (predicted == capture.labels(0)).float().mean() > 0.9


def test_same_seed_same_splats(capture: Capture, config: TrainConfig):
    one, other, third = (trained(capture, config, seed=seed) for seed in (1, 1, 2))
    for name, tensor in one.tensors().items():
        assert torch.equal(tensor, other.tensors()[name]), name
    assert not torch.equal(one.means, third.means)


def test_randomness_of_the_process_does_not_count(capture: Capture, config: TrainConfig):
    splats = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        before = torch.get_rng_state()
        splats.append(trained(capture, config, steps=25))
        assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(splats[0].means, splats[1].means)


def test_gaussians_grow_up_to_the_cap_and_never_beyond(capture: Capture, config: TrainConfig):
    counts: list[int] = []
    fit(
        capture,
        replace(config, steps=100, refine_every=5, max_gaussians=300),
        on_progress=lambda state, *_: counts.append(len(state.splats)),
    )
    assert counts == sorted(counts) and counts[-1] == 300 and counts[0] < 200


def test_max_seconds_ends_the_run(capture: Capture, config: TrainConfig):
    state = fit(capture, replace(config, max_seconds=0.3))
    assert state.step > 0
    assert state.seconds >= 0.3


def test_works_without_label_maps_and_points(capture: Capture, config: TrainConfig):
    bare = replace(capture, label_maps=None, points=None, point_colors=None)
    splats = trained(bare, config, steps=3, max_gaussians=30_000)
    assert splats.identities is None and splats.classifier is None
    assert len(splats) > 1000


def test_photos_without_a_label_map_train_colour_only(capture: Capture, config: TrainConfig):
    assert capture.label_maps is not None
    some = replace(capture, label_maps=[*[None] * (len(capture) - 1), capture.label_maps[-2]])
    splats = trained(some, config, steps=10, test_every=0)
    assert splats.classifier is not None and splats.classifier.ids == (0, 3, 7)


def test_label_maps_of_held_out_photos_alone_train_no_identities(
    capture: Capture, config: TrainConfig, said: list[str]
):
    assert capture.label_maps is not None
    only = replace(capture, label_maps=[capture.label_maps[0], *[None] * (len(capture) - 1)])
    assert trained(only, config, steps=3).identities is None
    assert len(said) == 1 and "object 3, 7," in said[0]


def test_objects_that_only_held_out_photos_show_are_no_classes(
    capture: Capture, config: TrainConfig, said: list[str]
):
    assert capture.label_maps is not None
    maps = [*capture.label_maps]
    maps[8] = torch.full((64, 72), 11)
    named = replace(capture, label_maps=maps, object_names={11: "vase"})
    splats = trained(named, config, steps=3)
    assert splats.classifier is not None and splats.classifier.ids == (0, 3, 7)
    (line,) = said
    assert "object 11 (vase)" in line and "--test-every 0" in line
    every = trained(named, config, steps=3, test_every=0, color_correction="off")
    assert every.classifier is not None and every.classifier.ids == (0, 3, 7, 11)
    assert len(said) == 1


def test_no_photos_left(capture: Capture, config: TrainConfig):
    with pytest.raises(StyleSplatError, match="no photos left to train on"):
        fit(capture, replace(config, test_every=1))


def test_kernels_are_compiled_before_the_clock_starts(
    capture: Capture, config: TrainConfig, monkeypatch: pytest.MonkeyPatch
):
    """They are others for other numbers of photos in a round."""
    rounds: list[tuple[int, bool]] = []

    def noted(run: Run, state: State) -> tuple[State, torch.Tensor]:
        rounds.append((len(run.photos(state)), run.every(run.config.identity_every, state.step)))
        return train_step(run, state)

    monkeypatch.setattr(loop, "train_step", noted)
    fit(capture, replace(config, steps=9, photos_at_once=3))
    assert rounds[:2] == [(3, True), (3, False)], "on a copy"
    assert rounds[2:] == [(3, True), (3, False), (3, True)]


def test_of_several_processes_a_round_has_one_step(
    capture: Capture, config: TrainConfig, monkeypatch: pytest.MonkeyPatch
):
    """Its kernel is another one than that of a step for each photo."""
    photos: list[int] = []
    run, state = begun(capture, config, 2, of_photos=True)
    monkeypatch.setattr(loop, "train_step", lambda run, state: photos.append(run.batch))
    warm_up_training(run, state, Ranks(0, 2))
    warm_up_training(run, state, ALONE)
    assert photos == [1, 1, 2, 2]


def test_what_is_told_is_what_was_measured(capture: Capture, config: TrainConfig):
    told: list[tuple[float, float]] = []
    fit(capture, config, on_progress=lambda _, loss, psnr: told.append((loss, psnr)))
    assert told[-1][0] < told[0][0] and told[-1][1] > told[0][1]
    assert all(0 < loss < 3 and 5 < psnr < 60 for loss, psnr in told)


def test_an_interrupt_without_a_checkpoint_still_stops(capture: Capture, config: TrainConfig):
    def stop(state: State, loss: float, psnr: float) -> None:
        assert state.step == 1, "the step after the interrupt must not begin"
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        fit(capture, replace(config, photos_at_once=1), on_progress=stop)


def test_photos_of_several_sizes(capture: Capture, config: TrainConfig):
    sizes = capture.cameras.sizes.clone()
    sizes[3] = torch.tensor([72, 40])
    photos = [*capture.photos]
    photos[3] = photos[3][:40].contiguous()
    cameras = replace(capture.cameras, sizes=sizes)
    mixed = replace(capture, cameras=cameras, photos=photos, label_maps=None)
    assert len(trained(mixed, config)) == 400


GPU = torch.device("cuda")
STATE = first_state(random_splats(1500))


class Listener(Silence):
    """Remembers what it is told."""

    def __init__(self) -> None:
        self.begun: tuple = ()
        self.done = 0.0
        self.notes: list[str] = []

    @contextmanager
    def task(self, what: str, total, unit: str, done) -> Iterator["Listener"]:
        self.begun, self.done = (what, total, unit), done
        yield self

    def advance(self, amount: float = 1) -> None:
        self.done += amount

    def note(self, text: str) -> None:
        self.notes.append(text)


def at(step: int, seconds: float = 0.0) -> State:
    return replace(STATE, step=step, seconds=seconds)


@pytest.fixture
def listener() -> Iterator[Listener]:
    here = Listener()
    with observed(here):
        yield here


def test_steps_are_counted(listener: Listener):
    with progress_meter(TrainConfig(steps=50), at(0)) as meter:
        for step in (10, 20, 27):
            meter.report(at(step), 0.5, 20.0)
            assert listener.done == step
    assert listener.begun == ("training", 50, "step")


def test_seconds_are_counted_where_they_end_the_run(listener: Listener):
    with progress_meter(TrainConfig(max_seconds=5.0), at(0)) as meter:
        meter.report(at(10, 2.5), 0.5, 20.0)
        assert listener.done == 2.5
        meter.report(at(20, 5.7), 0.5, 20.0)
        assert listener.done == 5.0, "not beyond the end"
    assert listener.begun == ("training", 5.0, "s")


def test_notes_hold_loss_psnr_and_gaussians(listener: Listener):
    with progress_meter(TrainConfig(), at(0)) as meter:
        meter.report(at(1), 0.5, 20.0)
    assert listener.notes == ["loss 0.5000, PSNR 20.00 dB, 1,500 Gaussians"]


def test_what_is_told_is_smooth_and_gets_there(listener: Listener):
    with progress_meter(TrainConfig(steps=9000), at(0)) as meter:
        meter.report(at(10), 1.0, 10.0)
        meter.report(at(20), 0.0, 30.0)
        meter.report(at(2000), 0.0, 30.0)
    losses = [float(note.split(",")[0].removeprefix("loss ")) for note in listener.notes]
    assert losses[0] == 1 > losses[1] > 0.5 and losses[2] == 0


class Heard(Exception):
    """What the handlers of these tests raise."""


@pytest.fixture(params=TAKEN, ids=lambda number: number.name)
def number(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch):
    """A signal, with a handler that raises `Heard`."""

    def hear(*_: object) -> None:
        raise Heard

    before = signal.signal(request.param, hear)
    yield request.param
    signal.signal(request.param, before)


def test_signals_wait_and_then_do_what_they_would_have_done(number: signal.Signals):
    reached = False
    with pytest.raises(Heard), deferred_interrupt() as interrupted:
        assert not interrupted()
        signal.raise_signal(number)
        signal.raise_signal(number)
        reached = interrupted()
    assert reached
    with pytest.raises(Heard):
        signal.raise_signal(number)


def test_also_after_an_error(number: signal.Signals):
    before = signal.getsignal(number)
    with pytest.raises(ValueError), deferred_interrupt():
        assert signal.getsignal(number) is not before
        raise ValueError
    assert signal.getsignal(number) is before


def test_what_is_ignored_stays_ignored(number: signal.Signals):
    signal.signal(number, signal.SIG_IGN)  # nohup
    with deferred_interrupt() as interrupted:
        signal.raise_signal(number)
        assert not interrupted()


def test_other_threads_handle_no_signals():
    found: list[bool] = []

    def work() -> None:
        with deferred_interrupt() as interrupted:
            found.append(interrupted())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [False]
