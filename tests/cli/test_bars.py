"""Progress and messages on stderr: bars in a terminal, lines elsewhere."""

import re
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from stylesplat.cli.bars import Bars
from stylesplat.progress import observed, say, task, track, uncounted

LIMIT = 10.0  # seconds to wait for a line


@contextmanager
def shown(*, terminal: bool, delay: float) -> Iterator[Bars]:
    with closing(Bars(terminal=terminal, delay=delay)) as bars, observed(bars):
        yield bars


def wait_for(text: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What is written to stderr until a text is among it."""
    found, start = "", time.monotonic()
    while text not in found and time.monotonic() < start + LIMIT:
        time.sleep(0.01)
        found += capsys.readouterr().err
    assert text in found
    return found


@pytest.mark.parametrize("terminal", [True, False])
def test_all_goes_to_stderr(terminal: bool, capsys: pytest.CaptureFixture[str]):
    with shown(terminal=terminal, delay=0):
        assert list(track("abc", "spelling", unit="letter")) == ["a", "b", "c"]
        with task("reading", 2, done=1) as reading:
            say("No label maps.")
            say("No label maps.")
            reading.note("loss 0.5")
            reading.advance()
    written = capsys.readouterr()
    assert written.out == ""
    assert "spelling" in written.err and "3/3" in written.err
    assert written.err.count("No label maps.\n") == 1, "no line is said twice"
    assert "2/2" in written.err and "loss 0.5" in written.err
    assert terminal or not re.search(r"[\r\x1b\x08]|^\s*$", written.err.rstrip(), re.MULTILINE)


def test_tasks_within_tasks_have_lines_of_their_own(capsys: pytest.CaptureFixture[str]):
    with shown(terminal=False, delay=0), task("outer", 2, unit="photo") as outer:
        list(track(range(3), "inner"))
        outer.advance()
    lines = capsys.readouterr().err.splitlines()
    assert all(re.match(r"(outer|inner): +\d+%\|\d/\d \[", line) for line in lines)
    assert any("inner: 100%|3/3" in line for line in lines) and "outer:  50%|1/2" in lines[-1]


def test_a_bar_that_a_line_has_drawn_is_ended(capsys: pytest.CaptureFixture[str]):
    with shown(terminal=True, delay=60), task("outer", 9), task("inner", 7):
        say("A line.")
    last = capsys.readouterr().err.rpartition("\n")[2]
    assert not last.strip("\r"), "what is written next begins a line"


@pytest.mark.parametrize("terminal", [True, False])
def test_work_that_does_not_advance_is_drawn(terminal: bool, capsys: pytest.CaptureFixture[str]):
    with shown(terminal=terminal, delay=0.01):
        with task("solving", 1):
            assert "0/1" in wait_for("solving", capsys)
        with uncounted("waiting"):
            wait_for("waiting: 00:0", capsys)


def test_the_rate_is_that_of_the_work_however_often_it_is_drawn(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("stylesplat.cli.bars.TICK", 0.03)
    with shown(terminal=False, delay=0.04), task("training", 40) as bar:
        for _ in range(24):
            time.sleep(0.05)
            bar.advance()
    rates = re.findall(r"([\d.]+)step/s", capsys.readouterr().err)
    assert len(rates) > 5 and all(0 < float(rate) <= 20 for rate in rates), "20 a second at most"


@pytest.mark.parametrize("terminal", [True, False])
def test_it_is_shown_that_a_command_works_where_no_task_does(
    capsys: pytest.CaptureFixture[str], terminal: bool
):
    with shown(terminal=terminal, delay=0.01) as bars:
        bars.fill_gaps()
        wait_for("starting: 00:0", capsys)
        list(track("abc", "spelling"))
        found = wait_for("working: 00:0", capsys)
        assert "starting: " not in found.split("spelling")[-1]
        with task("reading", 1):
            wait_for("reading", capsys)
        wait_for("working: 00:0", capsys)
        bars.clear()
        if terminal:
            last = capsys.readouterr().err.rpartition("\r")[0].rpartition("\r")[2]
            assert not last.strip(), "nothing of it stays"
