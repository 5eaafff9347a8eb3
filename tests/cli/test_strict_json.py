"""JSON as its standard has it: neither files nor `--json` hold NaN or Infinity, which it lacks."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from balls import TRAINED, painted, write_pictures
from stylesplat.cli import main
from stylesplat.io import scene_folder
from stylesplat.io.json_files import strict_json

pytestmark = pytest.mark.usefixtures("quick_painting")
MEASURED = {"psnr": math.inf, "rmse": math.nan, "by": {"vase": -math.inf}, "all": [math.nan, 1.5]}
WRITTEN = {"psnr": None, "rmse": None, "by": {"vase": None}, "all": [None, 1.5]}


def strictly(text: str) -> Any:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is no JSON")

    return json.loads(text, parse_constant=refuse)


def test_what_commands_print(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    styled = painted(TRAINED, "red", write_pictures(tmp_path)[0])
    scene_folder.save(styled, tmp_path / "scene")
    monkeypatch.setattr("stylesplat.evaluate", lambda *_, **__: MEASURED)
    assert main(["evaluate", str(tmp_path / "scene"), "--json"]) == 0
    assert strictly(capsys.readouterr().out) == WRITTEN
    assert scene_folder.open(tmp_path / "scene").metrics["evaluate"] == WRITTEN


@pytest.mark.parametrize("make", [float, np.float32, torch.tensor, np.array])
def test_numbers_of_all_kinds(make: Callable[[float], Any]):
    assert strictly(strict_json({"a": {"b": (make(math.nan),)}})) == {"a": {"b": [None]}}
    assert strictly(strict_json([make(-math.inf), make(1.5)])) == [None, 1.5]
    assert strict_json([np.int64(3), torch.tensor(3)]) == "[3, 3]"
