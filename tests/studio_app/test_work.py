import threading
from collections.abc import Iterator

import pytest

from stylesplat.studio_app.session import Stopped, Worker


@pytest.fixture
def failures() -> list[Exception]:
    return []


@pytest.fixture
def worker(failures: list[Exception]) -> Iterator[Worker]:
    found = Worker(failures.append)
    yield found
    found.close()


def held(worker: Worker) -> threading.Event:
    """Keeps the worker busy until it is set."""
    gate, busy = threading.Event(), threading.Event()

    def wait() -> None:
        busy.set()
        gate.wait(10)

    worker.ask(wait)
    assert busy.wait(10)
    return gate


def test_jobs_are_done_in_order_the_patient_ones_last_and_the_last_of_a_kind(worker: Worker):
    done = list[str]()
    gate = held(worker)
    worker.ask(lambda: done.append("thumbnail"), patient=True)
    worker.ask(lambda: done.append("0.4"), kind="slider")
    worker.ask(lambda: done.append("click"))
    worker.ask(lambda: done.append("0.5"), kind="slider")
    gate.set()
    assert worker.wait_until_idle()
    assert done == ["click", "0.5", "thumbnail"]


def test_what_is_under_way_for_somebody_can_be_ended_and_nothing_else(
    worker: Worker, failures: list[Exception]
):
    begun, ended, done = threading.Event(), list[str](), list[str]()
    between = threading.Event()

    def work() -> None:
        try:
            with worker.interruptible("me"):
                begun.set()
                while not worker.background_task:  # for ever
                    worker.run_urgent_jobs()
        except Stopped:
            ended.append("work")

    worker.ask(work)
    worker.ask(lambda: done.append("next"), patient=True)
    assert begun.wait(10)
    worker.interrupt("somebody else")
    worker.ask(lambda: worker.interrupt("me"))  # what is let in between is not ended
    worker.ask(between.set)
    assert between.wait(10) and not ended
    while not ended and not done:
        worker.interrupt("me")
    assert worker.wait_until_idle(10.0) and ended == ["work"] and not failures
    assert done == ["next"]
    worker.interrupt("me")
    worker.ask(lambda: done.append("later"))
    assert worker.wait_until_idle(10.0) and done[-1] == "later"


def test_long_work_goes_on_between_jobs_and_within_its_steps(worker: Worker):
    done = list[str]()

    def steps() -> Iterator[None]:
        for number in range(3):
            if number == 1:
                worker.ask(lambda: done.append("asked for in a step"))
                worker.run_urgent_jobs()
            done.append(f"step {number}")
            yield

    worker.set_background_task(steps())
    assert worker.wait_until_idle()
    assert done == ["step 0", "asked for in a step", "step 1", "step 2"]


def test_failures_are_told_and_end_nothing_else(worker: Worker, failures: list[Exception]):
    def fails() -> Iterator[None]:
        raise ValueError("of a step")
        yield

    worker.set_background_task(fails())
    worker.ask(lambda: 1 / 0)
    assert worker.wait_until_idle()
    assert sorted(type(each).__name__ for each in failures) == ["ValueError", "ZeroDivisionError"]
    assert worker.background_task is None
