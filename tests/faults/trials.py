"""Mutants given to readers in processes of their own, which may crash or hang."""

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
PATHS = (HERE.parents[1] / "src", HERE.parent, HERE)
MEMORY = 2**31  # bytes beyond what the program takes: more than the largest picture it admits
HANGS = 60.0  # seconds for a mutant: a watchdog, hundreds of times what it takes
STARTS = 300.0  # seconds for the first one: kernels may have to be compiled
GOOD = ("fine", "refused")


@dataclass(frozen=True)
class Trial:
    """How a reader fared with a mutant."""

    reader: str
    seed: int
    file: str = "?"
    """Which was the mutant."""
    outcome: str = "fine"
    """fine, refused; or traceback, garbled, memory, escaped, crash, hang."""
    told: str = ""
    """The message."""
    seconds: float = 0.0


@dataclass
class Worker:
    """A process that is started when it is needed, and again when it has died."""

    folder: Path
    """Where it may work."""
    memory: int = MEMORY
    script: Path = HERE / "fault_worker.py"
    patience: float = HANGS
    _process: subprocess.Popen[str] | None = field(default=None, init=False)
    _lines: queue.Queue[str] = field(default_factory=queue.Queue, init=False)

    def trials(self, reader: str, first: int, count: int) -> Iterator[Trial]:
        """Let a reader read mutants, one after the other."""
        seed, end = first, first + count
        while seed < end:
            process = self._running()
            assert process.stdin is not None
            process.stdin.write(json.dumps([reader, seed, end - seed]) + "\n")
            process.stdin.flush()
            for trial in self._answers(process, reader, range(seed, end)):
                yield trial
                seed = trial.seed + 1

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            assert self._process.stdin is not None
            self._process.stdin.close()
            self._process = None

    def _answers(
        self, process: subprocess.Popen[str], reader: str, seeds: range
    ) -> Iterator[Trial]:
        """Up to the one that ends the process, if one does."""
        for seed in seeds:
            try:
                line = self._lines.get(timeout=STARTS if seed == seeds[0] else self.patience)
            except queue.Empty:
                line = None
            if not line:
                yield self._ended(process, Trial(reader, seed), hung=line is None)
                return
            yield Trial(reader, *json.loads(line))

    def _ended(self, process: subprocess.Popen[str], trial: Trial, *, hung: bool) -> Trial:
        code = None if hung else process.wait()
        self.close()
        said = (self.folder / "worker.log").read_text(errors="replace").strip().splitlines()
        if code == 1:  # it tells of whatever a reader raises, so this is its own fault
            raise RuntimeError("\n".join(said[-5:]))
        outcome, told = ("hang", "") if hung else ("crash", f"exit {code}: {said[-1:]}")
        return Trial(trial.reader, trial.seed, outcome=outcome, told=told)

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None:
            self.folder.mkdir(parents=True, exist_ok=True)
            with (self.folder / "worker.log").open("w") as log:
                self._process = subprocess.Popen(
                    [sys.executable, self.script, self.folder, str(self.memory)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    text=True,
                    env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, PATHS))},
                )
            self._lines = queue.Queue()
            threading.Thread(target=self._listen, args=(self._process, self._lines)).start()
        return self._process

    def _listen(self, process: subprocess.Popen[str], lines: queue.Queue[str]) -> None:
        """Pass on what a process says; an empty line at its end."""
        assert process.stdout is not None
        with process.stdout:
            for line in process.stdout:
                lines.put(line)
        lines.put("")


def described(trial: Trial) -> str:
    """A trial that failed, and how to see it again."""
    return f"{trial.reader} seed {trial.seed} ({trial.file}): {trial.outcome}: {trial.told}"
