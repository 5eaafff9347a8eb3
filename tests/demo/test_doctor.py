"""`doctor`: the self-test on each device, its report, and what it finds wrong."""

import json
from dataclasses import replace

import pytest
import torch

from balls import TRAINED
from fake_cuda import cuda  # noqa: F401  (a fixture)
from processes import complaint, run
from stylesplat.demo import doctor as module
from stylesplat.demo.doctor import SelfTest, doctor
from stylesplat.rendering.nvrtc import DriverState
from stylesplat.rendering.render import render as real_render

TINY = SelfTest(photos=3, gaussians=500, train_steps=25, paint_steps=12, object_size=48, renders=1)
REPORT = {
    "versions": {
        **{"stylesplat": "1", "python": "3", "torch": "2", "nvrtc": "13.2", "numba": "0"},
        "gsplat": None,
    },
    "system": {"processor": "one", "threads": 2, "memory_gib": 8.0},
    "gpus": {"cuda:0": {"name": "a card", "memory_gib": 80.0}},
    "unused_gpu": None,
    "self_test": [
        {"device": "cpu", "problem": None, "psnr": 20.1, "seconds": 9.5},
        {"device": "cuda:0", "problem": "RuntimeError: no kernel", "seconds": 0.1},
    ],
    "problems": [],
}


@pytest.mark.usefixtures("quick_painting")
def test_the_devices_render_and_paint_alike(cuda: str):  # noqa: F811
    found = [doctor(device, TINY) for device in ("cpu", cuda)]
    (processor,), (card,) = (each["self_test"] for each in found)
    assert (processor["device"], card["device"]) == ("cpu", "cuda:0")
    assert found[1]["gpus"]["cuda:0"]["memory_gib"] > 1
    for row in (processor, card):
        assert row["problem"] is None
        assert row["agreement"] > 60 and row["nnfm_after"] < row["nnfm_before"]
    assert card["psnr"] == pytest.approx(processor["psnr"], abs=1)
    assert found[0]["versions"]["torch"] == torch.__version__
    json.dumps(found, allow_nan=False)


def test_what_fails_on_a_device_is_reported(monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no kernel image\nis available")

    monkeypatch.setattr(module, "train", fail)
    found = doctor("cpu", TINY)
    assert found["self_test"][0]["problem"] == "RuntimeError: no kernel image is available"
    assert found["problems"] == ["cpu: RuntimeError: no kernel image is available"]


def test_a_gpu_that_torch_cannot_use_is_a_problem_and_another_makers_is_not(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(module, "_test_devices", lambda *_: [])
    monkeypatch.setattr(module, "has_nvidia_gpu", lambda: False)
    monkeypatch.setattr(module, "why_gpu_is_unused", lambda: "the driver is too old")
    for driver, problems in (
        (DriverState((12, 4), gpus=1), ["the driver is too old"]),
        (DriverState((13, 2), gpus=0), []),
        (None, []),
    ):
        monkeypatch.setattr(module.nvrtc, "driver_state", lambda found=driver: found)
        found = doctor("auto", TINY)
        assert found["unused_gpu"] == "the driver is too old" and found["problems"] == problems


def test_a_device_that_renders_something_else_is_reported(monkeypatch: pytest.MonkeyPatch):
    trained = replace(TRAINED, metrics={"psnr": 20.0, "steps_per_second": 1.0})
    numbers = {key: {"vase": 1.0} for key in ("seconds_by_object", "nnfm_before", "nnfm_after")}
    painted = replace(TRAINED, metrics=numbers | {"precision": "float32"})
    monkeypatch.setattr(module, "train", lambda *_, **__: trained)
    monkeypatch.setattr(module, "select", lambda scene, *_, **__: scene)
    monkeypatch.setattr(module, "stylize", lambda *_, **__: painted)
    assert "painting does not" in doctor("cpu", TINY)["problems"][0]
    monkeypatch.setattr(module, "render", lambda *args: (real_render(*args)[0] + 0.1, None))
    assert "agree with the reference" in doctor("cpu", TINY)["problems"][0]


def test_the_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(module, "doctor", lambda device: REPORT)
    assert run("doctor") == 0
    shown = capsys.readouterr()
    assert not shown.out
    table, block = shown.err.split("```json")
    assert json.loads(block.split("```")[0]) == REPORT
    heading, processor, card = table.strip().splitlines()[-3:]
    assert len(heading) == len(processor) == len(card), "columns are aligned"
    assert run("doctor", "--json") == 0
    assert json.loads(capsys.readouterr().out) == REPORT
    monkeypatch.setattr(module, "doctor", lambda device: REPORT | {"unused_gpu": "an old driver"})
    assert run("doctor") == 0 and "not used: an old driver" in capsys.readouterr().err
    monkeypatch.setattr(module, "doctor", lambda device: REPORT | {"problems": ["cuda:0: bad"]})
    assert "cuda:0: bad" in complaint(capsys, "doctor", "--json")
