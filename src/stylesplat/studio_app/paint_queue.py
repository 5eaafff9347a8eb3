"""The queue of objects to paint, which are painted one after the other."""

import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.color import color_map, map_colors
from stylesplat.runtime import tidy_heap
from stylesplat.scene.content import opaque_rows
from stylesplat.scene.layers import Blend, split_name
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.scene.virtual_cameras import ring_cameras
from stylesplat.studio_app.edits import refuse_locked
from stylesplat.studio_app.history import Selected, StudioState, hidden_rows, replace_scene
from stylesplat.studio_app.messages import Progress
from stylesplat.studio_app.selecting import with_object_of_selection
from stylesplat.studio_app.session import Display, Session, Stopped
from stylesplat.stylization.config import StyleConfig, plain_settings
from stylesplat.stylization.painter import SurveyedObject
from stylesplat.stylization.style import Style, all_colors
from stylesplat.verbs.stylize import Live, stylize_live

SHOW_EVERY = 0.4  # seconds between two pictures of a painting
SHOWING = 0.2  # of the time of a painting, which its pictures may take
LONGEST_DRAWING = 0.5  # seconds; what lasts longer is another job, and the next picture no later
RECENT = 20  # steps whose speed is that of the rest
FIRST_GUESS = 2.0  # seconds of painting before the rest is estimated
QUEUE_SAMPLE = 20_000  # pixels of a style picture whose colours are measured
NOISE_GAUSSIANS, NOISE_NAME = 300, "noise"  # of the scene for the warm-up


@dataclass(frozen=True, eq=False)
class PaintJob:
    number: int
    name: str
    style: Style
    title: str
    instead: bool = False
    """Whether the picture so far stays until there are strokes."""
    selected: Selected | None = None
    """What becomes an object as soon as it is painted."""
    weights: Float[Tensor, " B"] | None = None
    """What the paint is to show through."""
    blend: Blend | None = None
    how: str = ""
    """In what it differs from the painting before, for the note of its step."""
    merge: object = None
    """Of the step of the history that made the object, which the painting becomes part of."""


class PaintQueue:
    def __init__(self, session: Session, **options: Any) -> None:
        self.session, self.options = session, options
        self.waiting, self._numbers = deque[PaintJob](), count(1)
        self._current: PaintJob | None = None
        self._latest: Live | None = None
        self._lives: Iterator[Live] = iter(())
        self._stopped: tuple[StudioState, PaintJob, Iterator[Live], Live] | None = None
        self._times = list[tuple[float, float]]()  # when each share of it was done
        self._usual = dict[str, list[tuple[float, float]]]()  # the times of the last, by quality
        self._drawn_at, self._drawing = 0.0, 0.0
        self._surveyed: tuple[Scene, Bool[Tensor, " B"], SurveyedObject] | None = None
        """What was below the layer that was painted last, its object's mask, and its survey."""
        session.interrupt = self.stop

    @property
    def stopped_note(self) -> str:
        """The painting that was stopped, if the scene is as it was left; otherwise empty."""
        stopped, session = self._stopped, self.session
        if stopped is None or session.painting or stopped[0].scene is not session.state.scene:
            return ""
        return stopped[0].note

    def ordered_settings(self, name: str) -> dict[str, Any] | None:
        """The settings of a layer that is painted now, or waits for it."""
        found = [job for job in (self._current, *self.waiting) if job and job.name == name]
        return plain_settings(found[-1].style.config) if found else None

    def paint(
        self,
        names: Sequence[str],
        style: Style,
        title: str,
        instead: bool = False,
        blend: Blend | None = None,
        how: str = "",
    ) -> None:
        """Paint layers, by the names of objects or of their further layers, one after the other.

        Their paintings that wait or are under way are dropped. `instead` keeps the picture of that
        under way until there are strokes. `blend` is that of the layers, if it is to be another.
        `how` they differ from those before is in the note.
        """
        if not names:
            raise StyleSplatError("Nothing is picked. Click an object first.")
        style.read()  # an unfit picture is told before anything changes
        for name in names:
            refuse_locked(self.session.state, name)
        before = {each.name: each for each in (*self.waiting, self._current) if each is not None}
        self.waiting = deque(each for each in self.waiting if each.name not in names)
        if self._current is not None and self._current.name in names:
            self._current, self.session.painting = None, False
            self.session.worker.set_background_task(None)
        numbers = self._numbers
        for name in names:
            job = PaintJob(next(numbers), name, style, title, instead, blend=blend, how=how)
            if name in before:
                job = replace(job, weights=before[name].weights, merge=before[name].merge)
            self.waiting.append(job)
        self._start()

    def paint_selection(self, style: Style, title: str) -> None:
        """Make an object of the selection and paint it, in one step of the history."""
        selected = self.session.state.selection
        assert selected is not None
        style.read()
        self.waiting = deque(each for each in self.waiting if each.selected is not selected)
        number = next(self._numbers)
        job = PaintJob(number, "the selection", style, title, selected=selected, merge=object())
        self.waiting.append(job)
        self._start()

    def remove(self, number: int) -> None:
        self.waiting = deque(each for each in self.waiting if each.number != number)
        self.session.on_change.call()

    def resume(self) -> None:
        if self._stopped is None or not self.stopped_note:
            raise StyleSplatError("No stopped painting can go on. Paint the object again.")
        _, job, lives, latest = self._stopped
        self._begin(job, lives, latest)

    def warm_up(self) -> None:
        """Paint a ball of noise for a step, which loads kernels, libraries and the network."""
        style = Style(torch.rand(64, 64, 3), config=StyleConfig(steps=1, object_size=48))
        with suppress(Stopped), self.session.listening(self.session.stopping.is_set):
            for _ in stylize_live(noise_ball(), NOISE_NAME, style, **self.options):
                pass

    def stop(self) -> bool:
        """End the painting with its result so far, and drop those that wait.

        Returns whether an object was being painted.
        """
        self.waiting.clear()
        current, latest, steps = self._current, self._latest, self.session.worker.background_task
        if current is None or steps is None:
            return False
        self.session.worker.set_background_task(None)
        if latest is None:
            self.session.history.take_back(current.merge)
            self._end()  # and the first step, if it has begun
            return True
        lives, step = self._lives, latest.state.step
        self._finish(current, latest, f"Painted {current.name} like {current.title}, {step} steps")
        self._stopped = (self.session.state, current, lives, latest)
        self.session.on_painted.call(current.name, f"{current.title}, {step} steps")
        self.session.on_change.call()
        return True

    def _start(self) -> None:
        """Begin the next painting if none is under way, and show its picture's colours at once."""
        session = self.session
        if session.painting:
            session.on_change.call()
            return
        if not self.waiting:
            return
        job = self.waiting.popleft()
        if job.selected is not None:
            job = self._as_object(job, job.selected)
        state = session.state
        own = session.masks.of(state.scene, split_name(job.name)[0])
        picked = state.scene.to_splats(own)
        if job.instead:
            session.preview = session.display
        else:
            splats = preview_colors(state.scene.splats, picked, job.style.read())
            session.preview = replace(session.display_of(state), splats=splats)
        survey = self._survey_of(state.scene.below(job.name), own)
        lives = stylize_live(state.scene, job.name, job.style, survey=survey, **self.options)
        self._begin(job, lives)

    def _survey_of(self, below: Scene, own: Bool[Tensor, " B"]) -> SurveyedObject | None:
        """What was measured of the same object on the same layers, if that was the last."""
        if self._surveyed is None:
            return None
        known, mask, survey = self._surveyed
        same = known.base is below.base and known.cameras is below.cameras
        return survey if same and known.layers == below.layers and torch.equal(mask, own) else None

    def _as_object(self, job: PaintJob, selected: Selected) -> PaintJob:
        """Make an object of what a job is to paint; it is picked if it is still selected."""
        before = self.session.state
        state = with_object_of_selection(replace(before, selection=selected), "painted")
        (name,) = state.picked
        if before.selection is not selected:
            state = replace(state, picked=before.picked, selection=before.selection)
        self.session.history.add(state, merge=job.merge)
        weights = selected.weights / 255 if selected.is_soft else None
        return replace(job, name=name, weights=weights)

    def _begin(self, job: PaintJob, lives: Iterator[Live], latest: Live | None = None) -> None:
        """Begin a painting, or go on with one from its latest result."""
        self._current, self._latest, self._stopped, self._lives = job, latest, None, lives
        self._times, self._drawn_at = [], 0.0
        self.session.painting = True
        self.session.progress = Progress(f"Painting {job.name} like {job.title}", 0.0)
        self.session.worker.set_background_task(self._steps(job, lives, begun=latest is not None))
        self.session.on_change.call()

    def _steps(self, job: PaintJob, lives: Iterator[Live], *, begun: bool) -> Iterator[None]:
        try:
            while True:
                # Stop ends the first step in its middle, as there is nothing to keep. Later ones
                # are finished, since what is ended in a step cannot go on
                stops = partial(self._is_dropped, job) if not begun else bool
                with self.session.listening(stops):
                    live = next(lives, None)
                stopped = self._stopped
                if self._is_dropped(job):  # or stopped, meanwhile
                    if live is not None and stopped is not None and stopped[2] is lives:
                        self._stopped = (*stopped[:3], live)
                    return
                if live is None:
                    break
                if not begun and live.survey is not None:
                    own = self.session.masks.of(live.before, split_name(job.name)[0])
                    self._surveyed = replace(live.below, composed=None), own, live.survey
                self._latest, begun = live, True
                if self._show(job, live):
                    yield  # the worker makes its pictures now, before the next step
                    self._drawing = min(time.monotonic() - self._drawn_at, LONGEST_DRAWING)
                else:
                    yield
            latest = self._latest
            assert latest is not None  # there is at least one step
            self._usual[job.style.config.quality] = self._times
            self._finish(job, latest, f"Painted {job.name} like {job.title}{job.how}")
            self.session.on_painted.call(job.name, job.title)
        except Stopped:
            return
        except Exception:
            self.waiting.clear()
            self.session.history.take_back(job.merge)
            self._end()
            raise
        self._start()

    def _is_dropped(self, job: PaintJob) -> bool:
        return self._current is not job

    def _show(self, job: PaintJob, live: Live) -> bool:
        """Show a step, unless pictures would take too large a share of the time.

        Returns whether it was shown.
        """
        now, step, steps = time.monotonic(), live.state.step, live.state.steps
        self._times.append((step / steps, now))
        if now - self._drawn_at < max(SHOW_EVERY, self._drawing / SHOWING):
            return False
        self._drawn_at = now
        left = seconds_left(self._times, self._usual.get(job.style.config.quality))
        what = f"Painting {job.name} like {job.title}: step {step} of {steps}"
        self.session.progress = Progress(what, step / steps, left)
        scene = _scene_of(job, live)
        state = replace_scene(self.session.state, scene, "")
        self.session.preview = Display(scene.splats, hidden_rows(state, self.session.masks))
        self.session.on_change.call()
        return True

    def _finish(self, job: PaintJob, live: Live, note: str) -> None:
        session = self.session
        state = replace_scene(session.state, _scene_of(job, live), note)
        session.history.add(state, merge=job.merge)
        self._end()

    def _end(self) -> None:
        self._current = self._latest = None
        self.session.preview = self.session.progress = None
        self.session.painting = False
        self.session.on_change.call()
        tidy_heap()  # else twenty paintings on 100,000 Gaussians take 2.6 GB and not 2.3


def _scene_of(job: PaintJob, live: Live) -> Scene:
    scene = live.scene()
    layer = scene.layer(job.name)
    assert layer is not None  # it is being painted
    if job.blend:
        layer = replace(layer, blend=job.blend)
    if job.weights is not None and layer.mask is None:
        layer = replace(layer, mask=job.weights[layer.rows])
    return scene.with_layer(layer) if job.blend or job.weights is not None else scene


@torch.no_grad()
def preview_colors(
    splats: Splats, picked: Bool[Tensor, " N"], pictures: tuple[Tensor, ...]
) -> Splats:
    """The colours of pictures on an object: a preview of its painting."""
    rows = opaque_rows(splats, picked)
    source = rgb_from_sh0(splats.sh0[rows, 0]).clamp(0, 1)
    pixels = all_colors(pictures)
    pixels = pixels[:: -(-len(pixels) // QUEUE_SAMPLE)]
    return map_colors(splats, picked, color_map(source, pixels.to(source)))


def seconds_left(
    times: Sequence[tuple[float, float]], usual: Sequence[tuple[float, float]] | None
) -> float | None:
    """How long a painting still takes, by when each share of it, or of an earlier one, was done."""
    (_, began), (share, now) = times[0], times[-1]
    if now - began < FIRST_GUESS:
        return None
    if usual:
        at = next((time for done, time in usual if done >= share), usual[-1][1])
        spent = at - usual[0][1]
        if spent > 0:
            return (now - began) * (usual[-1][1] - at) / spent
    earlier_share, earlier = times[max(0, len(times) - RECENT - 1)]
    return (now - earlier) / max(share - earlier_share, 1e-9) * (1 - share)


def noise_ball() -> Scene:
    points = torch.randn(NOISE_GAUSSIANS, 2, 3, generator=torch.Generator().manual_seed(0))
    splats = Splats(
        means=torch.nn.functional.normalize(points[:, 0], dim=1),
        quats=torch.eye(4)[:1].repeat(NOISE_GAUSSIANS, 1),
        scales=torch.full((NOISE_GAUSSIANS, 3), -1.6),
        opacities=torch.full((NOISE_GAUSSIANS,), 3.0),
        sh0=points[:, :1],
        shN=torch.zeros(NOISE_GAUSSIANS, 15, 3),
    )
    cameras = ring_cameras(splats, torch.tensor([0.0, 0.0, 1.0]))[::6].at_most(64)
    picked = torch.ones(NOISE_GAUSSIANS, dtype=torch.bool)
    return Scene(splats, cameras, objects={NOISE_NAME: SceneObject(picked)})
