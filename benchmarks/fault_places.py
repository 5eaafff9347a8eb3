"""Commands where there is no room, no home, or somebody else at work."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from fault_commands import (
    COMMANDS,
    PROGRAM,
    Command,
    described_end,
    fault_of,
    finish,
    run,
    start,
    state,
)
from fault_kills import OFTEN

import stylesplat as ss
from trials import Trial

ROOM = 64 * 2**20  # bytes of the small disk
NOBODY = 65534
HOMELESS = {"HOME": "/nonexistent", "XDG_CACHE_HOME": "/nonexistent"}
# Reads everything, as the interpreter may lie in somebody's home, and owns nothing
SETPRIV = (
    "setpriv",
    f"--reuid={NOBODY}",
    f"--regid={NOBODY}",
    "--clear-groups",
    "--inh-caps=-all,+dac_read_search",
    "--ambient-caps=-all,+dac_read_search",
)
COMMAND = {command.verb: command for command in COMMANDS}


@contextmanager
def small_disk(folder: Path) -> Iterator[str | None]:
    """A file system of little room; or why there can be none."""
    folder.mkdir()
    options = ["-t", "tmpfs", "-o", f"size={ROOM}", "tmpfs", str(folder)]
    done = subprocess.run(["mount", *options], capture_output=True, text=True)
    if done.returncode:
        yield done.stderr.strip() or "cannot mount"
        return
    try:
        yield None
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder: Path) -> Path:
    """A file that takes all the room there is."""
    filler = folder / "filler"
    with filler.open("wb", buffering=0) as file:
        for size in (2**20, 4096, 1):
            try:
                while True:
                    file.write(b"\1" * size)
            except OSError:
                continue
    return filler


def full_disk(place: Path, folder: Path) -> Iterator[Trial]:
    """Each verb that writes, on a disk that is full, and once there is room again."""
    with small_disk(folder) as reason:
        if reason:
            yield Trial("full disk", 0, outcome="skipped", told=reason)
            return
        for number, command in enumerate(COMMANDS):
            here = folder / "here"
            shutil.copytree(place, here)
            yield _without_room(command, here, number)
            shutil.rmtree(here)
        shutil.copytree(place, folder / "here")
        yield _training_goes_on(folder / "here")


def _without_room(command: Command, here: Path, number: int) -> Trial:
    trial = partial(Trial, "full disk", number, command.verb)
    result = here / command.result
    before = state(result) if result.exists() else "absent"
    filler = fill(here.parent)
    try:
        done = run(command, here)
        fault = described_end(done, (1,))
        if fault:
            return trial("traceback" if "exit" not in fault else "exit", fault)
        last = done.stderr.strip().splitlines()[-1]
        if "disk full" not in last.lower():
            return trial("exit", last)
        filler.unlink()
        lost = fault_of(command, here, (before,))
        fault = lost or described_end(run(command, here), (0,)) or fault_of(command, here)
        return trial("lost", fault) if fault else trial("refused", last)
    except subprocess.TimeoutExpired:
        return trial("hang")
    finally:
        filler.unlink(missing_ok=True)


def _training_goes_on(here: Path) -> Trial:
    """Checkpoints fail, and then there is room for the scene."""
    trial = partial(Trial, "full disk", len(COMMANDS), "train, with room at its end")
    command = Command(
        "train", ("capture", "-o", "trained", "--max-seconds", "6"), "trained", ss.open
    )
    filler = fill(here.parent)
    process = start(command, here, (sys.executable, "-c", OFTEN))
    assert process.stderr is not None
    said = ""
    for line in process.stderr:  # until a checkpoint could not be written
        said += line
        if "checkpoint" in line.lower():
            break
    filler.unlink()
    done = finish(process)
    done.stderr = said + done.stderr
    fault = described_end(done, (0,)) or fault_of(command, here)
    if not fault and "checkpoint" not in said.lower():
        fault = "no word of the checkpoint"
    return trial("lost", fault) if fault else trial()


def unprivileged(place: Path, folder: Path) -> Iterator[Trial]:
    """Commands of a user who owns nothing but the folder, and has no home."""
    shutil.copytree(place, folder)
    folder.parent.chmod(0o755)
    trial = partial(Trial, "unprivileged")
    if os.getuid() != 0 or shutil.which("setpriv") is None:
        yield trial(0, outcome="skipped", told="needs root and setpriv")
        return
    for path in (folder, *folder.rglob("*")):
        os.chown(path, NOBODY, NOBODY)
    temporary = folder / "temporary"  # without what an earlier run compiled
    temporary.mkdir()
    os.chown(temporary, NOBODY, NOBODY)
    for number, verb in enumerate(("train", "select", "stylize", "render", "mask --box")):
        program = (*SETPRIV, *PROGRAM)
        try:
            done = run(COMMAND[verb], folder, program, TMPDIR=str(temporary), **HOMELESS)
        except subprocess.TimeoutExpired:
            yield trial(number, verb, "hang")
            continue
        fault = described_end(done, (0,)) or fault_of(COMMAND[verb], folder)
        yield trial(number, verb, "exit", fault) if fault else trial(number, verb)


def together(place: Path, folder: Path, repeats: int) -> Iterator[Trial]:
    """Two commands at the same moment."""
    select, stylize, train = (COMMAND[verb] for verb in ("select", "stylize", "train"))
    other = Command("select", ("scene", "--name", "lid", "--id", "7"), "scene", ss.open)
    styled = Command("select", ("styled", "--name", "lid", "--id", "7"), "styled", ss.open)
    pairs = (
        (select, other),
        (select, stylize),
        (train, train),
        (styled, COMMAND["adjust"]),
        (select, COMMAND["evaluate"]),
        (COMMAND["mask --from"], COMMAND["mask --box"]),
    )
    for number in range(repeats * len(pairs)):
        here = folder / "two"
        shutil.copytree(place, here)
        yield _pair(pairs[number % len(pairs)], here, number)
        shutil.rmtree(here)


def _pair(pair: Sequence[Command], here: Path, number: int) -> Trial:
    trial = partial(Trial, "two at once", number, " and ".join(each.verb for each in pair))
    processes = []
    for each in pair:
        processes.append(start(each, here))
        time.sleep(0.1 * (number % 3))
    try:
        done = [finish(process) for process in processes]
    except subprocess.TimeoutExpired:
        return trial("hang")
    faults = [described_end(each, (0, 1)) for each in done]
    faults += [fault_of(each, here) for each in pair]
    faults += [_forgotten(each, here) for each, end in zip(pair, done, strict=True) if _ok(end)]
    if not any(map(_ok, done)):
        faults.append("neither was done")
    fault = next((fault for fault in faults if fault), None)
    if fault:
        return trial("traceback" if "Traceback" in fault else "lost", fault)
    return trial() if all(map(_ok, done)) else trial("refused")


def _ok(done: subprocess.CompletedProcess[str]) -> bool:
    return done.returncode == 0


def _forgotten(command: Command, here: Path) -> str | None:
    """What a command that succeeded did is no longer there."""
    scene = ss.open(here / command.result) if command.verb in ("select", "adjust") else None
    if scene is None:
        return None
    if command.verb == "select":
        name = command.arguments[2]
        return None if name in scene.objects else f"{name} was selected, and is gone"
    strengths = {each.strength for each in scene.layers}
    return None if strengths == {0.3} else f"0.3 was set, and it is {strengths}"
