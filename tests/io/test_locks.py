"""One process at a time."""

import errno
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from filelock import FileLock

import stylesplat
from stylesplat.errors import StyleSplatError
from stylesplat.io import locks
from stylesplat.io.locks import locked
from stylesplat.io.places import refuse_unwritable

HOLDER = """
import sys, time
from filelock import FileLock
from pathlib import Path
lock = FileLock(sys.argv[1])
lock.acquire()
Path(sys.argv[1]).write_text("4711")
print("held", flush=True)
time.sleep(float(sys.argv[2]))
lock.release()
"""


def hold(path: Path, seconds: float) -> subprocess.Popen:
    """Another process that holds a lock from now on."""
    command = [sys.executable, "-c", HOLDER, path, str(seconds)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_lock_lies_beside_and_goes(tmp_path: Path):
    with locked(tmp_path / "scene"):
        assert names(tmp_path) == [".scene.lock"]
        assert (tmp_path / ".scene.lock").read_text() == str(os.getpid())
        with locked(tmp_path / "x" / ".." / "scene"):
            assert names(tmp_path) == [".scene.lock"]
        assert names(tmp_path) == [".scene.lock"], "the inner one does not give it back"
    assert names(tmp_path) == []


def test_folders_that_were_made_for_a_lock_go(tmp_path: Path):
    with locked(tmp_path / "a" / "b" / "scene"):
        assert names(tmp_path / "a" / "b") == [".scene.lock"]
        (tmp_path / "a" / "kept").touch()
    assert names(tmp_path / "a") == ["kept"]


def test_another_process_is_told_of_and_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    monkeypatch.setattr(locks, "PATIENCE", 0.1)
    other = hold(tmp_path / ".scene.lock", 60)
    try:
        with (
            pytest.raises(StyleSplatError, match=r"scene: another stylesplat \(process 4711\) is"),
            locked(tmp_path / "scene"),
        ):
            pytest.fail("the block must not run")
    finally:
        other.kill()
        other.communicate()
    assert said == [
        f"Waiting for another stylesplat (process 4711) that changes {tmp_path / 'scene'}."
    ]
    with locked(tmp_path / "scene"):  # which a killed process does not keep
        assert (tmp_path / ".scene.lock").read_text() == str(os.getpid())
    assert names(tmp_path) == [] and len(said) == 1


def test_who_waits_gets_it(tmp_path: Path, said: list[str]):
    other = hold(tmp_path / ".scene.lock", 1.0)
    with locked(tmp_path / "scene"):
        assert len(said) == 1
    other.communicate()


def test_threads_exclude_one_another(tmp_path: Path):
    inside, most = 0, 0

    def enter() -> None:
        nonlocal inside, most
        with locked(tmp_path / "scene"):
            inside += 1
            most = max(most, inside)
            time.sleep(0.01)
            inside -= 1

    threads = [threading.Thread(target=enter) for _ in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == 1 and names(tmp_path) == []


COUNTER = """
import sys
from pathlib import Path
from stylesplat.io.locks import locked
from stylesplat.io.places import refuse_unwritable
folder = Path(sys.argv[1])
total = folder / "total"
for _ in range(40):
    with locked(folder / "scene"):
        total.write_text(str(int(total.read_text()) + 1))
"""


def test_processes_exclude_one_another_though_the_file_goes(tmp_path: Path):
    (tmp_path / "total").write_text("0")
    environment = {**os.environ, "PYTHONPATH": str(Path(stylesplat.__file__).parents[1])}
    command = [sys.executable, "-c", COUNTER, tmp_path]
    counting = [subprocess.Popen(command, env=environment) for _ in range(3)]
    assert [process.wait() for process in counting] == [0, 0, 0]
    assert (tmp_path / "total").read_text() == "120"
    assert names(tmp_path) == ["total"]


def test_where_nothing_can_be_made_beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    place, elsewhere = tmp_path / "place", tmp_path / "elsewhere"
    place.mkdir()
    elsewhere.mkdir()
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != place)
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))
    with locked(place / "scene"):
        assert names(place) == []
        (one,) = names(elsewhere)
        with locked(place / "other"):
            assert len(names(elsewhere)) == 2
    assert one.startswith("stylesplat-") and names(elsewhere) == []


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOLCK, "No locks available"), NotImplementedError()]
)
def test_without_locks_it_goes_on_and_says_so(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    def acquire(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(FileLock, "acquire", acquire)
    for _ in range(2):
        with locked(tmp_path / "scene"):
            pass
    assert len(said) == 1 and said[0].startswith(f"Cannot lock anything in {tmp_path} (")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs Linux's /proc")
def test_nobody_is_blamed_for_a_place_that_takes_no_file(said: list[str]):
    """Where root may write, and yet nothing can be made."""
    with locked("/proc/x"), pytest.raises(StyleSplatError, match=r"^Cannot write /proc/x: "):
        refuse_unwritable("/proc/x")
    assert not said
