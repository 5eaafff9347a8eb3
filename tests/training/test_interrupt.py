import signal
import threading

import pytest

from stylesplat.training.interrupt import deferred_interrupt


def test_ctrl_c_waits():
    with deferred_interrupt() as interrupted:
        assert not interrupted()
        signal.raise_signal(signal.SIGINT)
        assert interrupted()
    assert interrupted()


def test_afterwards_ctrl_c_is_what_it_was():
    before = signal.getsignal(signal.SIGINT)
    with deferred_interrupt():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_also_after_an_error():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError), deferred_interrupt():
        raise ValueError
    assert signal.getsignal(signal.SIGINT) is before


def test_other_threads_handle_no_signals():
    found: list[bool] = []

    def work() -> None:
        with deferred_interrupt() as interrupted:
            found.append(interrupted())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [False]
