import signal
import threading

import pytest

from stylesplat.signals import TAKEN
from stylesplat.training.interrupt import deferred_interrupt


class Heard(Exception):
    """What the handlers of these tests raise."""


@pytest.fixture(params=TAKEN, ids=lambda number: number.name)
def number(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch):
    """A signal, with a handler that raises `Heard`."""

    def hear(*_: object) -> None:
        raise Heard

    before = signal.signal(request.param, hear)
    yield request.param
    signal.signal(request.param, before)


def test_signals_wait_and_then_do_what_they_would_have_done(number: signal.Signals):
    reached = False
    with pytest.raises(Heard), deferred_interrupt() as interrupted:
        assert not interrupted()
        signal.raise_signal(number)
        signal.raise_signal(number)
        reached = interrupted()
    assert reached
    with pytest.raises(Heard):
        signal.raise_signal(number)


def test_also_after_an_error(number: signal.Signals):
    before = signal.getsignal(number)
    with pytest.raises(ValueError), deferred_interrupt():
        assert signal.getsignal(number) is not before
        raise ValueError
    assert signal.getsignal(number) is before


def test_what_is_ignored_stays_ignored(number: signal.Signals):
    signal.signal(number, signal.SIG_IGN)  # nohup
    with deferred_interrupt() as interrupted:
        signal.raise_signal(number)
        assert not interrupted()


def test_other_threads_handle_no_signals():
    found: list[bool] = []

    def work() -> None:
        with deferred_interrupt() as interrupted:
            found.append(interrupted())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [False]
