import time

import pytest
import torch

from stylesplat.stylization.features.precision import fastest_dtype


def test_the_choice_is_made_once(monkeypatch: pytest.MonkeyPatch):
    found = fastest_dtype("cpu")
    assert found in (torch.float32, torch.bfloat16)

    def refuse() -> float:
        raise AssertionError("it was timed again")

    monkeypatch.setattr(time, "process_time", refuse)
    assert fastest_dtype("cpu") == found


@pytest.mark.parametrize(("speedup", "expected"), [(2.0, torch.bfloat16), (1.1, torch.float32)])
def test_the_faster_one_is_chosen(
    speedup: float, expected: torch.dtype, monkeypatch: pytest.MonkeyPatch
):
    def seconds(dtype: torch.dtype) -> float:
        return 1.0 if dtype == torch.float32 else 1 / speedup

    monkeypatch.setattr("stylesplat.stylization.features.precision._convolution_seconds", seconds)
    assert fastest_dtype.__wrapped__("cpu") == expected
