"""A run's checkpoints, minute by minute: one that cannot be written costs a line, not the run."""

import time

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say
from stylesplat.training.checkpoint import Checkpoint, save_checkpoint
from stylesplat.training.state import State

CHECKPOINT_SECONDS = 60.0


class Keeper:
    """Keeps a run where it can be continued from, if that is wanted."""

    def __init__(self, checkpoint: Checkpoint | None, state: State) -> None:
        self._checkpoint = checkpoint
        self._kept = state.step  # of the file, if there is one
        self._written = time.monotonic()
        self._fails = False

    def after_step(self, state: State) -> None:
        """Write a checkpoint if it is time; say when that does not work, and when it does again."""
        if self._checkpoint is None or time.monotonic() - self._written <= CHECKPOINT_SECONDS:
            return
        error = self._try(self._checkpoint, state)
        if error is not None and not self._fails:
            say(f"{error} The training goes on all the same.")
        elif error is None and self._fails:
            say("Checkpoints can be written again.")
        self._fails = error is not None

    def at_end(self, state: State, *, interrupted: bool) -> None:
        """Write the last checkpoint; say so if an interrupted run cannot be kept."""
        if self._checkpoint is None:
            return
        error = self._try(self._checkpoint, state)
        if error is None or (self._fails and not interrupted):
            return
        there = "There is no checkpoint"
        if self._checkpoint.path.exists():
            there = f"The last checkpoint is of step {self._kept:,}"
        say(f"{error} {there}, and the run was at step {state.step:,}.")

    def _try(self, checkpoint: Checkpoint, state: State) -> StyleSplatError | None:
        try:
            save_checkpoint(checkpoint, state)
            self._kept = state.step
            return None
        except StyleSplatError as error:
            return error
        finally:
            self._written = time.monotonic()
