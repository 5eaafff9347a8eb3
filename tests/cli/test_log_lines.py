"""Where no terminal is, progress is a line now and then."""

import re
import sys
from io import StringIO

import pytest

from stylesplat import cli
from stylesplat.cli import bars
from stylesplat.cli.bars import Bars
from stylesplat.cli.log_lines import EVERY, LogLines
from stylesplat.progress import Observer, observed, say, task, track


class Clock:
    """Seconds that pass only when told to."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def lines(clock: Clock, capsys: pytest.CaptureFixture[str]):
    """What was written since the last look; nothing of it on stdout, where JSON goes."""

    def lines() -> list[str]:
        shown = capsys.readouterr()
        assert shown.out == "" and not re.search(r"[\r\x1b\x08]", shown.err)
        return shown.err.splitlines()

    with observed(LogLines(clock)):
        yield lines


def test_it_is_an_observer():
    assert isinstance(LogLines(), Observer)


def test_a_line_every_ten_seconds_and_one_at_the_end(clock: Clock, lines):
    with task("training", 3000) as training:
        for _ in range(30):
            clock.now += EVERY / 2 + 0.01
            training.note("loss 0.5")
            training.advance(100)
        told = lines()
    assert len(told) == 14
    assert told[0] == "training: 200 of 3000 steps, 2 min left (loss 0.5)"
    assert told[-1] == "training: 2800 of 3000 steps, 10 s left (loss 0.5)"
    assert lines() == ["training: done, 3000 of 3000 steps in 3 min"]


def test_short_work_says_nothing(clock: Clock, lines):
    for _ in track(range(9), "a moment"):
        clock.now += 1
    assert lines() == []


def test_each_task_has_its_own_lines(clock: Clock, lines):
    with task("outer", 2, unit="photo") as outer:
        for _ in track(range(3), "inner"):
            clock.now += 6
        clock.now += 1
        outer.advance()
        clock.now += 3
    inner, done, first, ended = lines()
    assert inner == "inner: 2 of 3 views, 6 s left"
    assert done == "inner: done, 3 of 3 views in 18 s"
    assert first == "outer: 1 of 2 photos, 19 s left"
    assert ended == "outer: ended, 1 of 2 photos in 22 s"


def test_the_first_step_tells_nothing_of_the_rest(clock: Clock, lines):
    with task("painting", 300) as painting:
        for _ in range(2):
            clock.now += 20
            painting.advance(3)
    assert lines()[:2] == ["painting: 3 of 300 steps", "painting: 6 of 300 steps, 33 min left"]


def test_what_an_earlier_run_did_makes_this_one_no_faster(clock: Clock, lines):
    with task("training", 100, done=80) as training:
        clock.now += 20
        training.advance(10)
    assert lines()[0] == "training: 90 of 100 steps, 20 s left"


@pytest.mark.parametrize(
    ("unit", "total", "amount", "expected"),
    [
        ("s", 60.0, 20.0, "work: 20 of 60 s, 22 s left"),
        ("B", 5_000_000, 2_500_000, "work: 2.5 of 5.0 MB, 11 s left"),
        ("stretch", 4, 1, "work: 1 of 4 stretches, 33 s left"),
        ("view", None, 3, "work: 3 views"),
    ],
)
def test_units(unit: str, total: float | None, amount: float, expected: str, clock: Clock, lines):
    with task("work", total, unit=unit) as work:
        clock.now += 11
        work.advance(amount)
    assert lines()[0] == expected


def test_what_is_said_is_a_line(lines):
    with task("work", 2):
        say("No label maps.")
    assert lines() == ["No label maps."]


@pytest.mark.parametrize("observer", [LogLines, Bars])
def test_a_line_is_said_once(observer: type[LogLines | Bars], capsys: pytest.CaptureFixture[str]):
    """Some verbs open a capture more than once, and each time what is odd of it is told."""
    with observed(observer()):
        say("2 photos are missing.")
        say("3 photos have no pose.")
        say("2 photos are missing.")
    assert capsys.readouterr().err == "2 photos are missing.\n3 photos have no pose.\n"


class Work:
    """A verb that takes long enough for a bar."""

    json = False

    def run(self) -> dict[str, int]:
        with task("work", 2) as work:
            work.advance()
        return {"a": 1}


@pytest.mark.parametrize("terminal", [True, False])
def test_bars_are_for_terminals(terminal: bool, monkeypatch: pytest.MonkeyPatch):
    shown = StringIO()
    monkeypatch.setattr(shown, "isatty", lambda: terminal)
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(bars, "DELAY", 0)
    cli._run(Work())
    assert ("work:  50%" in shown.getvalue()) == terminal
    assert terminal or shown.getvalue() == "a: 1\n"
