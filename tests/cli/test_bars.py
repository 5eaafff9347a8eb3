import sys
from io import StringIO

import pytest

from stylesplat.cli import bars
from stylesplat.cli.bars import Bars
from stylesplat.cli.log_lines import LogLines
from stylesplat.progress import Observer, observed, say, task, track


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bars, "DELAY", 0)


def test_it_is_an_observer():
    assert isinstance(Bars(), Observer)


def test_all_goes_to_stderr(capsys: pytest.CaptureFixture[str]):
    with observed(Bars()):
        assert list(track("abc", "spelling", unit="letter")) == ["a", "b", "c"]
        with task("reading", 2, done=1) as reading:
            say("No label maps.")
            reading.note("loss 0.5")
            reading.advance()
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "spelling" in shown.err and "3/3" in shown.err
    assert "No label maps.\n" in shown.err
    assert "2/2" in shown.err and "loss 0.5" in shown.err


@pytest.mark.parametrize(
    ("unit", "total", "amount", "expected"),
    [
        ("s", 7.0, 3.4, "3/7 s ["),
        ("B", 5_000_000, 2_500_000, "2.50M/5.00M"),
        ("view", None, 3, "3view"),
    ],
)
def test_units(
    unit: str, total: float | None, amount: float, expected: str, capsys: pytest.CaptureFixture[str]
):
    with observed(Bars()), task("work", total, unit=unit) as work:
        work.advance(amount)
    assert expected in capsys.readouterr().err


def test_short_work_shows_no_bar(capsys: pytest.CaptureFixture[str], monkeypatch):
    monkeypatch.setattr(bars, "DELAY", 60)
    with observed(Bars()):
        list(track(range(3), "a moment"))
    assert capsys.readouterr().err == ""


def test_a_bar_that_a_line_has_drawn_is_ended(capsys: pytest.CaptureFixture[str], monkeypatch):
    monkeypatch.setattr(bars, "DELAY", 60)
    with observed(Bars()), task("outer", 9), task("inner", 7):
        say("A line.")
    last = capsys.readouterr().err.rpartition("\n")[2]
    assert not last.strip("\r"), "what is written next begins a line"


class InterruptedTerminal(StringIO):
    """Ctrl-C comes as soon as something was written."""

    def write(self, text: str, /) -> int:
        super().write(text)
        raise KeyboardInterrupt


@pytest.mark.parametrize("observer", [Bars, LogLines])
def test_an_interruption_leaves_no_half_line(
    observer: type[Observer], monkeypatch: pytest.MonkeyPatch
):
    terminal = InterruptedTerminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with observed(observer()), pytest.raises(KeyboardInterrupt):
        say("A line.")
    assert terminal.getvalue() == "A line.\n"
