"""Ctrl-C and SIGTERM at processes of the command line: one line, and the status of shells."""

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Thread

import pytest

import stylesplat
from processes import LIMIT, run, wait_until
from stylesplat.__main__ import main as process
from stylesplat.cli.command import CONTINUES
from stylesplat.cli.train import FINISHES
from stylesplat.interrupts import WHOLE, preserve_signal_handlers, raise_if_interrupted

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(stylesplat.__file__).parents[1])}
WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class Begun:
    """A process of the command line in a terminal, with what it has said so far."""

    def __init__(self, folder: Path, *arguments: object) -> None:
        pty, termios = (pytest.importorskip(name) for name in ("pty", "termios"))
        self.said, self.out = folder / "stderr", folder / "stdout"
        self.said.touch()
        command = [sys.executable, "-m", "stylesplat", *map(str, arguments)]
        terminal, end = pty.openpty()
        termios.tcsetwinsize(end, (24, 200))
        with self.out.open("wb") as out:
            self.process = subprocess.Popen(command, env=ENVIRONMENT, stdout=out, stderr=end)
        os.close(end)
        self.listener = Thread(target=self._listen, args=(terminal,), daemon=True)
        self.listener.start()

    def _listen(self, terminal: int) -> None:
        with self.said.open("ab", buffering=0) as said, suppress(OSError):  # raised at the end
            while words := os.read(terminal, 4096):
                said.write(words)
        os.close(terminal)

    def wait_for(self, reached: Callable[["Begun"], bool]) -> None:
        wait_until(lambda: reached(self), self.process, self.said.read_text)

    def says(self, words: str) -> bool:
        return words in self.said.read_text()

    def has_loaded(self, library: str) -> bool:
        return library in Path(f"/proc/{self.process.pid}/maps").read_text()

    def ended_by(self, number: signal.Signals) -> str:
        """How to go on, as the one line says with which it ends; bars end with carriage returns."""
        self.process.send_signal(number)
        status = self.process.wait(timeout=LIMIT)
        self.listener.join(timeout=60)
        assert not self.listener.is_alive()
        said = self.said.read_text()
        assert status == 128 + number, said
        assert self.out.read_text() == ""
        assert not any(word in said for word in ("Traceback", "***", "gnored")), said
        *before, last = said.splitlines()
        assert not any(line.startswith("stylesplat: ") for line in before), said
        start = f"stylesplat: {WORDS[number]}. "
        assert last.startswith(start)
        return last.removeprefix(start)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize(
    ("library", "number"),
    [
        ("_json", signal.SIGTERM),  # with what parses the command
        ("libtorch_python", signal.SIGINT),
    ],
)
def test_while_it_starts(library: str, number: signal.Signals, capture: Path, tmp_path: Path):
    out = tmp_path / "new" / "out"
    begun = Begun(tmp_path, "train", capture, "-o", out, "--steps", 99_999, "--device", "cpu")
    begun.wait_for(lambda begun: begun.has_loaded(library))
    begun.ended_by(number)
    files = {p.name for p in tmp_path.rglob("*") if p.is_file()}
    assert files == {"stderr", "stdout"}


def test_a_training_is_kept_and_goes_on(capture: Path, tmp_path: Path):
    out = tmp_path / "out"
    options = ("--device", "cpu", "--max-seconds", 3)
    begun = Begun(tmp_path, "train", capture, "-o", out, *options)
    begun.wait_for(lambda begun: begun.says("Gaussians"))
    assert begun.ended_by(signal.SIGTERM) == f"{CONTINUES} {FINISHES}"
    assert [p.name for p in (tmp_path / "out.partial").iterdir()] == ["checkpoint_lift.pt"]
    assert run("train", capture, "-o", out, *options) == 0
    assert not (tmp_path / "out.partial").exists()


def test_the_viewer(scene: Path, tmp_path: Path):
    pytest.importorskip("uvicorn")
    begun = Begun(tmp_path, "view", scene)
    begun.wait_for(lambda begun: begun.says("Ctrl-C closes the viewer."))
    assert begun.says("StyleSplat: http://127.0.0.1:") and begun.says("/?token=")
    assert begun.ended_by(signal.SIGINT) == "The viewer is closed."


def test_signals_are_ignored_once_the_work_is_done(capsys, monkeypatch):
    """As a process does it, but here: what the verb gets, and what comes after it."""

    def verb() -> int:
        signal.raise_signal(signal.SIGTERM)
        raise_if_interrupted()
        return 0

    monkeypatch.setattr("stylesplat.cli.main", verb)
    with preserve_signal_handlers():
        assert process() == 128 + signal.SIGTERM
        signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    gc.unfreeze()
    assert capsys.readouterr().err == f"stylesplat: terminated. {WHOLE}\n"


START = """import pathlib, signal, sys, threading, time
from stylesplat.interrupts import catch_signals, raise_if_interrupted, wait_until
from stylesplat.progress import track
"""
CATCH = f"{START}catch_signals()\n"

ONCE = f"""{CATCH}
signal.raise_signal(signal.SIGTERM)
threading.Thread(target=raise_if_interrupted).start()
print("goes on")
try:
    for _ in track(range(2), "work"):
        print("step")
except KeyboardInterrupt as error:
    raise_if_interrupted()
    print(type(error).__name__)
"""

WAITING = f"""{CATCH}
main = threading.main_thread().ident
threading.Timer(0.3, signal.pthread_kill, (main, signal.SIGINT)).start()
try:
    wait_until(threading.Event().wait)
except KeyboardInterrupt as error:
    print(type(error).__name__)
"""

TWICE = f"""{CATCH}
signal.raise_signal(signal.SIGINT)
signal.raise_signal(signal.SIGTERM)
print("one request")
time.sleep(2.1)
signal.raise_signal(signal.SIGTERM)
print("too late")
"""

IGNORED = f"""{START}
signal.signal(signal.SIGINT, signal.SIG_IGN)
catch_signals()
signal.raise_signal(signal.SIGINT)
raise_if_interrupted()
print("goes on")
"""

LOADING = f"""{CATCH}
sys.path.insert(0, FOLDER)
pathlib.Path(FOLDER, "slow.py").write_text(
    "import signal\\n"
    "from stylesplat.photo_libraries import pycolmap\\n"
    "signal.raise_signal(signal.SIGTERM)\\nprint('loaded')"
)
try:
    import slow
    raise_if_interrupted()
except KeyboardInterrupt as error:
    print(type(error).__name__)
"""


@pytest.mark.parametrize(
    ("script", "status", "expected"),
    [
        pytest.param(ONCE, 0, "goes on\nstep\nTerminated\n", id="where work advances"),
        pytest.param(
            WAITING,
            0,
            "Interrupted\n",
            id="where it waits",
            marks=pytest.mark.skipif(sys.platform == "win32", reason="needs pthread_kill"),
        ),
        pytest.param(TWICE, 143, "one request\n", id="twice"),
        pytest.param(IGNORED, 0, "goes on\n", id="ignored"),
        pytest.param(LOADING, 0, "loaded\nTerminated\n", id="while a library takes signals"),
    ],
)
def test_no_signal_is_lost_or_does_harm(script: str, status: int, expected: str, tmp_path: Path):
    code = script.replace("FOLDER", repr(str(tmp_path)))
    done = subprocess.run(
        [sys.executable, "-u", "-c", code],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=LIMIT,
    )
    assert (done.returncode, done.stdout) == (status, expected), done.stderr
    assert "Traceback" not in done.stderr
    if status:
        assert done.stderr == f"\nstylesplat: terminated. {WHOLE}\n"
