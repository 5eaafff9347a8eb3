"""What the panel Paint does: objects painted one after the other, to be watched and stopped."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.shown import Shown
from stylesplat.rendering.sh import rgb_from_sh0
from stylesplat.runtime import tidy_heap
from stylesplat.scene.content import solid
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.session import Progress, Session, Stopped
from stylesplat.studio_app.studio_state import State, names_in, shown, unless_all, with_scene
from stylesplat.stylization.colors import color_map, map_colors
from stylesplat.stylization.style import Picture, Style
from stylesplat.verbs.stylize_live import Live, stylize_live

SHOW_EVERY = 0.4  # seconds between two pictures of what is painted
SAMPLE = 20_000  # pixels of a style picture that tell its colours


@dataclass(frozen=True)
class Order:
    """An object that is to be painted."""

    name: str
    """A name or a label id."""
    style: Style
    """What it is to look like."""
    title: str
    """What the picture is called."""


class Easel:
    """What is painted now, and what waits."""

    def __init__(self, session: Session, **options: Any) -> None:
        """Begin with nothing.

        Args:
            session: Whose scene is painted on.
            options: Of `stylize_live`.
        """
        self.session, self._options = session, options
        self._waiting = deque[Order]()
        self._current: Order | None = None
        self._latest: Live | None = None
        self._lives: Iterator[Live] = iter(())
        self._left: tuple[State, Order, Iterator[Live]] | None = None
        self._began, self._shown_at, self._first = 0.0, 0.0, 0
        session.interrupt = self._stop

    @property
    def waiting(self) -> int:
        """How many objects wait."""
        return len(self._waiting)

    @property
    def can_continue(self) -> bool:
        """Whether there is something that was stopped, and nothing was changed since."""
        left = self._left
        return left is not None and not self.session.painting and left[0] is self.session.state

    def paint(self, names: tuple[str, ...], style: Style, title: str) -> None:
        """Have objects painted, each by itself, soon."""

        def job() -> None:
            if not names:
                raise StyleSplatError("Nothing is picked. Click what is to be painted first.")
            self._waiting.extend(Order(name, style, title) for name in names)
            if not self.session.painting:
                self._start()

        self.session.ask(job)

    def stop(self) -> None:
        """Keep what is painted so far, soon; what waits is not painted."""

        self.session.ask(self._stop)

    def go_on(self) -> None:
        """Go on with what was stopped, soon."""

        def job() -> None:
            if not self.can_continue:
                raise StyleSplatError("Nothing was stopped that could be gone on with.")
            assert self._left is not None  # that was asked just now
            _, order, lives = self._left
            self._begin(order, lives)

        self.session.ask(job)

    def _stop(self) -> bool:
        """In the worker's thread: stop; whether something was being painted."""
        self._waiting.clear()
        current, latest, steps = self._current, self._latest, self.session.worker.lengthy
        if current is None or steps is None:
            return False
        self.session.worker.go_on_with(None)
        if latest is None:
            self._end()  # and the first step, if it has begun
            return True
        lives, step = self._lives, latest.state.step
        self._kept(current, latest, f"Stopped at step {step} of {current.name}")
        self._left = (self.session.state, current, lives)
        self.session.tell_painted(current.name, f"{current.title} to step {step}")
        self.session.tell_change()
        return True

    def _start(self) -> None:
        """Begin with what has waited longest; its colours are there at once."""
        if not self._waiting:
            return
        order, session = self._waiting.popleft(), self.session
        state = session.state
        picked = session.masks.of(state.scene, order.name)
        splats = previewed(state.scene.splats, picked, order.style.read())
        session.preview = replace(shown(replace(state, glow=False), session.masks), splats=splats)
        lives = stylize_live(state.scene, order.name, order.style, **self._options)
        self._begin(order, lives)

    def _begin(self, order: Order, lives: Iterator[Live]) -> None:
        self._current, self._latest, self._left, self._lives = order, None, None, lives
        self._began, self._first, self._shown_at = time.monotonic(), 0, 0.0
        self.session.painting = True
        self.session.progress = Progress(f"{order.name}: {order.title}", 0.0)
        self.session.worker.go_on_with(self._steps(order, lives))
        self.session.tell_change()

    def _steps(self, order: Order, lives: Iterator[Live]) -> Iterator[None]:
        try:
            # Nothing would be kept of the first step: Stop ends it in its middle
            live = self._next(lives, stopped=lambda: self._current is not order)
            while live is not None:
                if self._current is not order:  # it was stopped meanwhile
                    return
                self._latest = live
                self._show(order, live)
                yield
                live = self._next(lives)
            latest = self._latest
            assert latest is not None  # there is at least one step
            self._kept(order, latest, f"Painted {order.name} like {order.title}")
            self.session.tell_painted(order.name, order.title)
        except Stopped:
            return
        except Exception:
            self._waiting.clear()
            self._end()
            raise
        self._start()

    def _next(
        self, lives: Iterator[Live], stopped: Callable[[], bool] = lambda: False
    ) -> Live | None:
        with self.session.listening(stopped):
            return next(lives, None)

    def _show(self, order: Order, live: Live) -> None:
        """Now and then, how far it is."""
        now, step, steps = time.monotonic(), live.state.step, live.state.steps
        if not self._first:
            self._first, self._began = step, now
        if now - self._shown_at < SHOW_EVERY:
            return
        self._shown_at = now
        done = step - self._first
        left = (now - self._began) / done * (steps - step) if done else None
        what = f"{order.name}: {order.title}, step {step} of {steps}"
        self.session.progress = Progress(what, step / steps, left)
        scene = live.scene()
        self.session.preview = Shown(scene.splats, hidden=self._hidden(scene))
        self.session.tell_change()

    def _hidden(self, scene: Scene) -> Bool[Tensor, " N"] | None:
        """What the user does not want to see meanwhile."""
        state, known, masks = self.session.state, names_in(scene), self.session.masks
        hidden = masks.together(scene, [name for name in state.hidden if name in known])
        if state.alone:
            picked = masks.together(scene, [name for name in state.picked if name in known])
            hidden = None if picked is None else ~picked
        return unless_all(hidden)

    def _kept(self, order: Order, live: Live, note: str) -> None:
        session = self.session
        state = with_scene(session.state, live.scene(), note)
        session.history.add(replace(state, glow=False))
        self._end()

    def _end(self) -> None:
        self._current = self._latest = None
        self.session.preview = self.session.progress = None
        self.session.painting = False
        self.session.tell_change()
        tidy_heap()  # else twenty paintings on 100,000 Gaussians take 2.6 GB and not 2.3


@torch.no_grad()
def previewed(splats: Splats, picked: Bool[Tensor, " N"], pictures: tuple[Tensor, ...]) -> Splats:
    """The colours of some pictures on an object, as a first idea of what it will look like."""
    rows = solid(splats, picked)
    source = rgb_from_sh0(splats.sh0[rows, 0]).clamp(0, 1)
    pixels = torch.cat([picture.reshape(-1, 3) for picture in pictures])
    pixels = pixels[:: -(-len(pixels) // SAMPLE)]
    matrix, offset = color_map(source, pixels.to(source))
    return map_colors(splats, picked, matrix, offset)


def styled(picture: Picture, **settings: Any) -> Style:
    """A style, its picture read once, so that an unfit one is told at once.

    Raises:
        StyleSplatError: If the picture is unfit, or a setting out of range.
    """
    style = Style(picture, **settings)
    style.read()
    return style
