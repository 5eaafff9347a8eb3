"""Progress and messages on stderr: bars in a terminal, lines elsewhere."""

import re

import pytest

from stylesplat.cli.bars import Bars
from stylesplat.progress import observed, say, task, track


@pytest.mark.parametrize("terminal", [True, False])
def test_all_goes_to_stderr(terminal: bool, capsys: pytest.CaptureFixture[str]):
    with observed(Bars(terminal=terminal, delay=0)):
        assert list(track("abc", "spelling", unit="letter")) == ["a", "b", "c"]
        with task("reading", 2, done=1) as reading:
            say("No label maps.")
            say("No label maps.")
            reading.note("loss 0.5")
            reading.advance()
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "spelling" in shown.err and "3/3" in shown.err
    assert shown.err.count("No label maps.\n") == 1, "no line is said twice"
    assert "2/2" in shown.err and "loss 0.5" in shown.err
    assert terminal or not re.search(r"[\r\x1b\x08]|^\s*$", shown.err.rstrip(), re.MULTILINE)


def test_tasks_within_tasks_have_lines_of_their_own(capsys: pytest.CaptureFixture[str]):
    with observed(Bars(terminal=False, delay=0)), task("outer", 2, unit="photo") as outer:
        list(track(range(3), "inner"))
        outer.advance()
    lines = capsys.readouterr().err.splitlines()
    assert all(re.match(r"(outer|inner): +\d+%\|\d/\d \[", line) for line in lines)
    assert any("inner: 100%|3/3" in line for line in lines) and "outer:  50%|1/2" in lines[-1]


def test_a_bar_that_a_line_has_drawn_is_ended(capsys: pytest.CaptureFixture[str]):
    with observed(Bars(terminal=True, delay=60)), task("outer", 9), task("inner", 7):
        say("A line.")
    last = capsys.readouterr().err.rpartition("\n")[2]
    assert not last.strip("\r"), "what is written next begins a line"
