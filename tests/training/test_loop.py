import gc
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from numba.core import types
from numba.core.dispatcher import Dispatcher

from balls import CAMERAS, enlarged
from capture_files import write_cut_outs
from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.interrupts import SIGNALS, held_signals
from stylesplat.io.captures.capture_folder import load
from stylesplat.progress import Observer, observed
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.training.config import TrainConfig
from stylesplat.training.initialize import first_splats
from stylesplat.training.loop import fit
from stylesplat.training.views import split_views


def error(splats: Splats, capture: Capture, row: int) -> float:
    image = rasterize(splats, capture.cameras[row])[0][0]
    return float((image.clamp(0, 1) - capture.photos[row] / 255).square().mean())


def trained(capture: Capture, config: TrainConfig, **settings) -> Splats:
    return fit(capture, replace(config, **settings)).splats.detach()


def test_held_out_views_get_better(capture: Capture, config: TrainConfig):
    generator = torch.Generator().manual_seed(0)
    start = first_splats(capture, sh_degree=3, max_gaussians=400, generator=generator)
    scores: list[tuple[float, float]] = []
    config = replace(config, steps=150)
    state = fit(capture, config, on_progress=lambda _, *means: scores.append(means))
    splats = state.splats.detach()
    _, held_out = split_views(capture, config.test_every)
    for row in held_out:
        assert error(splats, capture, row) < 0.5 * error(start, capture, row)
    assert scores[-1][0] < scores[0][0] and scores[-1][1] > scores[0][1]
    assert all(0 < loss < 3 and 5 < psnr < 60 for loss, psnr in scores)


def test_identities_learn_the_labels(capture: Capture, config: TrainConfig):
    splats = trained(capture, config, steps=300, coarse_to_fine=False)
    assert splats.classifier is not None and splats.classifier.ids == (0, 3, 7)
    image = rasterize(splats, capture.cameras[0], features=splats.identities)[0][0, ..., 3:]
    classes = splats.classifier.logits(image).argmax(-1)
    predicted = torch.tensor(splats.classifier.ids)[classes]
    assert (predicted == capture.labels(0)).float().mean() > 0.9


def test_the_seed_alone_decides(capture: Capture, config: TrainConfig):
    splats = []
    for seed in (1, 1, 2):
        torch.manual_seed(len(splats))  # randomness of the process does not count
        before = torch.get_rng_state()
        splats.append(trained(capture, config, seed=seed, steps=25))
        assert torch.equal(torch.get_rng_state(), before)
    for name, tensor in splats[0].tensors().items():
        assert torch.equal(tensor, splats[1].tensors()[name]), name
    assert not torch.equal(splats[0].means, splats[2].means)


def test_captures_without_label_maps_or_points(capture: Capture, config: TrainConfig):
    bare = replace(capture, label_maps=None, points=None, point_colors=None)
    splats = trained(bare, config, steps=3, max_gaussians=30_000)
    assert splats.identities is None and splats.classifier is None
    assert len(splats) > 1000
    assert capture.label_maps is not None
    some = replace(capture, label_maps=[*[None] * (len(capture) - 1), capture.label_maps[-2]])
    splats = trained(some, config, steps=10, test_every=0)
    assert splats.classifier is not None and splats.classifier.ids == (0, 3, 7)
    with pytest.raises(StyleSplatError, match="no photos left to train on"):
        fit(capture, replace(config, test_every=1))


def test_photos_of_several_sizes(capture: Capture, config: TrainConfig):
    sizes = capture.cameras.sizes.clone()
    sizes[3] = torch.tensor([72, 40])
    photos = [*capture.photos]
    photos[3] = photos[3][:40].contiguous()
    cameras = replace(capture.cameras, sizes=sizes)
    mixed = replace(capture, cameras=cameras, photos=photos, label_maps=None)
    assert len(trained(mixed, config)) == 400


def test_no_kernel_can_crash_where_it_is_interrupted(capture: Capture, config: TrainConfig):
    """numba unpickles the type of an array that is returned, and does not see that fail."""

    def is_number(kind: types.Type) -> bool:
        parts = kind if isinstance(kind, types.Tuple | types.UniTuple) else [kind]
        return all(
            isinstance(part, types.Number | types.Boolean | types.NoneType) for part in parts
        )

    fit(capture, replace(config, steps=25))
    gc.unfreeze()  # what was loaded before the tests is hidden otherwise
    found = [
        (name, compiled.signature.return_type)
        for it in gc.get_objects()
        if issubclass(type(it), Dispatcher)
        and (name := it.py_func.__module__).startswith("stylesplat.")
        if not it.targetoptions.get("no_cpython_wrapper")
        for compiled in it.overloads.values()
    ]
    gc.freeze()
    assert len({name for name, _ in found}) > 4
    assert [(name, kind) for name, kind in found if not is_number(kind)] == []


def test_nothing_is_where_cut_out_photos_are_transparent(tmp_path: Path):
    cut_outs = load(write_cut_outs(tmp_path / "balls", enlarged(CAMERAS, 2)))
    config = TrainConfig(steps=250, max_gaussians=400, photos_at_once=1)
    splats = fit(cut_outs, config).splats.detach()
    _, held_out = split_views(cut_outs, config.test_every)
    assert evaluate_views(splats, replace(cut_outs, label_maps=None), held_out)["psnr"] > 22
    for row in range(len(cut_outs)):
        alpha = cut_outs.alpha(row)
        assert alpha is not None
        _, coverage, _ = rasterize(splats, cut_outs.cameras[row])
        assert coverage[0, ..., 0][alpha == 0].mean() < 0.05
        assert coverage[0, ..., 0][alpha > 250].mean() > 0.9


class Listener(Observer):
    """Remembers what it is told."""

    def __init__(self) -> None:
        self.begun: list[tuple] = []
        self.done = 0.0
        self.notes: list[str] = []

    @contextmanager
    def task(self, what: str, total, unit: str, done) -> Iterator["Listener"]:
        self.begun.append((what, total, unit))
        self.done = done
        yield self

    def advance(self, amount: float = 1) -> None:
        self.done += amount

    def note(self, text: str) -> None:
        self.notes.append(text)


def test_the_bar_counts_seconds_where_they_end_the_run(capture: Capture, config: TrainConfig):
    with observed(listener := Listener()):
        state = fit(capture, replace(config, max_seconds=0.3))
    assert ("training", 0.3, "s") in listener.begun
    early, last = (note.split(", ")[1] for note in (listener.notes[0], listener.notes[-1]))
    assert early.endswith("dB (rises most near the end)") and last.endswith("dB")
    assert listener.done == pytest.approx(0.3) and state.seconds >= 0.3 and state.step > 0


class Heard(Exception):
    """What the handlers of these tests raise."""


def raise_heard(*_: object) -> None:
    raise Heard


@pytest.fixture(params=SIGNALS, ids=lambda number: number.name)
def number(request: pytest.FixtureRequest):
    """A signal, with a handler that raises `Heard`."""
    before = signal.signal(request.param, raise_heard)
    yield request.param
    signal.signal(request.param, before)


def test_signals_wait_and_then_do_what_they_would_have_done(number: signal.Signals):
    reached, before = False, signal.getsignal(number)
    with pytest.raises(Heard), held_signals() as interrupted:
        assert not interrupted()
        signal.raise_signal(number)
        signal.raise_signal(number)
        reached = interrupted()
    assert reached and signal.getsignal(number) is before
    with pytest.raises(ValueError), held_signals():
        assert signal.getsignal(number) is not before
        raise ValueError
    assert signal.getsignal(number) is before
    signal.signal(number, signal.SIG_IGN)  # nohup: what is ignored stays ignored
    with held_signals() as interrupted:
        signal.raise_signal(number)
        assert not interrupted()


def test_other_threads_handle_no_signals():
    def work() -> bool:
        with held_signals() as interrupted:
            return interrupted()

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(work).result() is False


def test_what_masks_leave_out_is_not_learned(capture: Capture, config: TrainConfig):
    magenta = torch.tensor([255, 0, 255], dtype=torch.uint8)
    valid = torch.ones(64, 72, dtype=torch.bool)
    valid[:, :36] = False
    photos = [photo.where(valid[..., None], magenta) for photo in capture.photos]
    painted = replace(capture, photos=photos, label_maps=None)
    masked = trained(replace(painted, valid_masks=[valid] * len(photos)), config)
    black = [photo * valid[..., None] for photo in photos]
    other = replace(painted, photos=black, valid_masks=[valid] * len(photos))
    for name, values in trained(other, config).tensors().items():
        assert torch.equal(values, masked.tensors()[name])


@pytest.mark.parametrize("background", ["black", "white"])
def test_cut_outs_before_a_colour_may_take_it(tmp_path: Path, background: str):
    cameras = enlarged(CAMERAS, 2)
    capture = load(write_cut_outs(tmp_path, cameras), masks=False)
    config = TrainConfig(steps=30, max_gaussians=300)
    splats = trained(capture, config, background=background)
    level = {"black": 0.0, "white": 1.0}[background]
    image, alpha, _ = rasterize(splats, cameras[1])
    assert (image[0] + (1 - alpha[0]) * level)[0, 0].tolist() == pytest.approx([level] * 3, abs=0.2)


def test_a_background_needs_transparent_photos(capture: Capture, config: TrainConfig):
    with pytest.raises(StyleSplatError, match=r"white.*transparent"):
        trained(capture, config, background="white")
