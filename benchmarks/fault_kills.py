"""Commands that are killed at random moments, and run again."""

import random
import shutil
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from subprocess import CompletedProcess, TimeoutExpired

from fault_commands import (
    BOOT,
    COMMANDS,
    Command,
    described_end,
    fault_of,
    finish,
    leftovers,
    run,
    start,
    state,
)

from trials import Trial

# By signal the statuses that a command may end with: it may have been done before
ENDS = {signal.SIGKILL: (0, -9), signal.SIGTERM: (0, 143), signal.SIGINT: (0, 130)}
# A checkpoint every third of a second instead of every minute, to be killed amid of
OFTEN = (
    "import runpy, stylesplat.training.checkpoint as saved; saved.CHECKPOINT_SECONDS = 0.3; "
    "runpy.run_module('stylesplat', run_name='__main__', alter_sys=True)"
)


@dataclass(frozen=True)
class Known:
    """How a command goes if nothing happens."""

    command: Command
    seconds: float
    states: tuple[str, ...]
    """Before and after; empty where they differ from run to run."""


def learn(command: Command, place: Path, folder: Path) -> Known:
    """Run a command once."""
    shutil.copytree(place, folder)
    result = folder / command.result
    before = state(result) if result.exists() else "absent"
    begun = time.perf_counter()
    done = run(command, folder)
    if done.returncode:
        raise SystemExit(f"The suite's own command fails: {command.verb}: {done.stderr}")
    seconds = time.perf_counter() - begun
    states = () if command.verb == "train" else (before, state(result))
    shutil.rmtree(folder)
    return Known(command, seconds, states)


def kills(place: Path, folder: Path, count: int, seed: int, jobs: int) -> Iterator[Trial]:
    """Kill commands of all verbs in turn, with each signal in turn."""
    known = [learn(command, place, folder / "learn") for command in COMMANDS]
    with ThreadPoolExecutor(jobs) as pool:
        trial = partial(killed, place, folder, known)
        yield from pool.map(trial, range(seed, seed + count))


def killed(place: Path, folder: Path, known: Sequence[Known], seed: int) -> Trial:
    """One command is killed at a moment that a seed chooses, then run again."""
    random_ = random.Random(seed)
    each = known[seed % len(known)]
    number = random_.choice([*ENDS])
    moment = random_.uniform(BOOT, 1.1 * each.seconds)
    what = f"{each.command.verb} {signal.Signals(number).name} after {moment:.2f} s"
    trial = partial(Trial, "kill", seed, what)
    here = folder / f"kill_{seed}"
    shutil.copytree(place, here)
    if random_.random() < 0.5:  # what it replaces is there already
        _put_old(each.command, place, here)
    states = (*each.states, state(here / each.command.result)) if each.states else ()
    try:
        done = _kill(each.command, here, number, moment)
        fault = described_end(done, ENDS[number])
        if fault:
            return trial("traceback" if "exit" not in fault else "exit", fault)
        fault = fault_of(each.command, here, states) or _again(each.command, here)
        return trial("lost", fault) if fault else trial()
    except TimeoutExpired:
        return trial("hang")
    finally:
        shutil.rmtree(here, ignore_errors=True)


def _put_old(command: Command, place: Path, here: Path) -> None:
    """Let there be an earlier result of the same kind."""
    target = here / command.result
    if not target.exists():
        sources = {"s.png": "wave.png", "out.ply": "a.ply", "views": "masks"}
        source = place / sources.get(command.result, "scene")
        (shutil.copytree if source.is_dir() else shutil.copy)(source, target)


def _kill(
    command: Command, here: Path, number: signal.Signals, moment: float
) -> CompletedProcess[str]:
    often = command.verb == "train" and number == signal.SIGKILL
    program = (sys.executable, "-c", OFTEN) if often else None
    process = start(command, here, program) if program else start(command, here)
    time.sleep(moment)
    process.send_signal(number)
    return finish(process)


def _again(command: Command, here: Path) -> str | None:
    """What is wrong when the same command is run again; None if nothing is."""
    kept = [*here.glob("*.partial/checkpoint_*.pt")]
    done = run(command, here)
    fault = described_end(done, (0,)) or fault_of(command, here)
    if fault:
        return f"run again: {fault}"
    if kept and "Continuing" not in done.stderr:
        return "the training began anew"
    return f"left over: {leftovers(here)}" if leftovers(here) else None
