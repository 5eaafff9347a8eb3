"""Kernels compile in another process while photos are made."""

from typing import Any

import pytest

from stylesplat.demo import rehearsal
from stylesplat.demo.rehearsal import compiled_meanwhile, rehearse


def test_all_of_training_and_painting_is_called():
    rehearse("stylize")  # an error in it would only cost time, so nobody would notice


def test_whoever_is_interrupted_does_not_wait_for_it(monkeypatch: pytest.MonkeyPatch):
    started = []
    popen = rehearsal.subprocess.Popen

    def start(*arguments: Any, **options: Any) -> Any:
        started.append(popen(*arguments, **options))
        return started[-1]

    monkeypatch.setattr(rehearsal.subprocess, "Popen", start)
    with pytest.raises(KeyboardInterrupt), compiled_meanwhile("train"):
        raise KeyboardInterrupt
    assert started[0].poll() is not None, "it has ended"
