"""JSON as its standard has it: neither files nor `--json` hold NaN or Infinity, which it lacks."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import stylesplat as ss
from processes import run
from stylesplat.io.json_files import strict_json

MEASURED = {"psnr": math.inf, "rmse": math.nan, "by": {"vase": -math.inf}, "all": [math.nan, 1.5]}
WRITTEN = {"psnr": None, "rmse": None, "by": {"vase": None}, "all": [None, 1.5]}


def strictly(text: str) -> Any:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is no JSON")

    return json.loads(text, parse_constant=refuse)


def test_what_commands_print(scene: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    scene_with_photos = ("evaluate", scene, "--capture", scene.parent, "--json")
    monkeypatch.setattr("stylesplat.load", lambda *_, **__: None)
    monkeypatch.setattr("stylesplat.evaluate", lambda *_, **__: MEASURED)
    assert run(*scene_with_photos) == 0
    assert strictly(capsys.readouterr().out) == WRITTEN
    assert ss.open(scene).metrics["evaluate"] == WRITTEN


@pytest.mark.parametrize("make", [float, np.float32, torch.tensor, np.array])
def test_numbers_of_all_kinds(make: Callable[[float], Any]):
    assert strictly(strict_json({"a": {"b": (make(math.nan),)}})) == {"a": {"b": [None]}}
    assert strictly(strict_json([make(-math.inf), make(1.5)])) == [None, 1.5]
    assert strict_json([np.int64(3), torch.tensor(3)]) == "[3, 3]"
