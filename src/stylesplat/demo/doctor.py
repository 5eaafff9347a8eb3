"""`doctor`: what this machine has, and whether StyleSplat computes correctly on its devices."""

import os
import platform
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from math import log10
from pathlib import Path
from typing import Any

import torch

from stylesplat.demo.demo_run import STYLES, copy_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.rendering import nvrtc
from stylesplat.rendering.render import (
    has_nvidia_gpu,
    pick_device,
    rasterize,
    render,
    why_gpu_is_unused,
)
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import GIB
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.style import Style
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize
from stylesplat.verbs.train import train

DOCTOR_LIBRARIES = (
    "stylesplat torch torchvision numba numpy scipy pycolmap gsplat transformers".split()
)
LEAST_AGREEMENT = 40.0  # dB of a device's picture and the reference's: float32 gives over 60
LEAST_FIT = 12.0  # dB of held-out photos after 50 steps; a grey picture has less


@dataclass(frozen=True)
class SelfTest:
    """How much the self-test does: by default less than a minute's work of two cores."""

    photos: int = 48  # of 480x360 pixels, the first
    downscale: float = 4.0
    gaussians: int = 4000
    train_steps: int = 50
    paint_steps: int = 20
    object_size: int = 80  # pixels of the painted object's longer side
    renders: int = 10


def doctor(device: str = "auto", budget: SelfTest | None = None) -> dict[str, Any]:
    """Describe the machine, and render, train and paint on its devices: `auto` is all of them.

    What is wrong is under `problems`, why a GPU is left out under `unused_gpu`. Raises a
    StyleSplatError if `device` is `cuda` and torch sees no GPU.
    """
    start = time.perf_counter()
    if device != "auto":
        pick_device(device)
    gpus = [f"cuda:{n}" for n in range(torch.cuda.device_count() if has_nvidia_gpu() else 0)]
    unused, driver = None if gpus else why_gpu_is_unused(), nvrtc.driver_state()
    problems = [unused] if unused and driver and driver.gpus else []
    tested = ["cpu"] if device in ("auto", "cpu") else []
    tested += gpus if device != "cpu" else []
    rows = [*_test_devices(tested, budget or SelfTest())]
    problems += [f"{row['device']}: {row['problem']}" for row in rows if row["problem"]]
    return {
        "versions": {"python": platform.python_version(), **_versions()},
        "system": {
            "platform": platform.platform(),
            "processor": _processor(),
            "threads": torch.get_num_threads(),
            "memory_gib": _memory(),
        },
        "gpus": {
            gpu: {"name": card.name, "memory_gib": round(card.total_memory / GIB, 1)}
            for gpu, card in zip(gpus, map(torch.cuda.get_device_properties, gpus), strict=True)
        },
        "unused_gpu": unused,
        "self_test": rows,
        "seconds": round(time.perf_counter() - start, 1),
        "problems": problems,
    }


def _versions() -> dict[str, str | None]:
    found = dict[str, str | None](dict.fromkeys(DOCTOR_LIBRARIES))
    for name in DOCTOR_LIBRARIES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    found |= {"torch": torch.__version__, "cuda": torch.version.cuda, "nvrtc": None}  # torch's own
    with suppress(StyleSplatError):
        found["nvrtc"] = nvrtc.version()
    return found


def _processor() -> str:
    with suppress(OSError, IndexError):
        return re.findall(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text())[0]
    return platform.processor() or platform.machine()


def _memory() -> float | None:
    with suppress(AttributeError, OSError, ValueError):  # not on Windows
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / GIB, 1)


def _test_devices(devices: list[str], budget: SelfTest) -> Iterator[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        place = copy_capture(Path(folder) / "capture")
        capture = load(place, downscale=budget.downscale)
        capture = capture.only(range(budget.photos))
        for device in devices:
            row, start = {"device": device, "problem": None}, time.perf_counter()
            try:
                for numbers in _test_device(device, capture, place / "styles", budget):
                    row |= numbers
                row["problem"] = _problem(row)
            except Exception as error:  # whatever goes wrong belongs into the report
                row["problem"] = " ".join(f"{type(error).__name__}: {error}".split())
            yield row | {"seconds": round(time.perf_counter() - start, 1)}


def _test_device(
    device: str, capture: Capture, styles: Path, budget: SelfTest
) -> Iterator[dict[str, Any]]:
    """Train, render and paint; yields the numbers of each."""
    scene = train(capture, device=device, steps=budget.train_steps, max_gaussians=budget.gaussians)
    speed, psnr = scene.metrics["steps_per_second"], scene.metrics["psnr"]
    yield {"steps_per_second": speed, "psnr": round(psnr, 2)}
    yield _test_rendering(device, scene, budget.renders)
    config = StyleConfig(steps=budget.paint_steps, object_size=budget.object_size)
    style = Style(styles / f"{STYLES['vase']}.jpg", config=config)
    scene = stylize(select(scene, "vase", id=1), {"vase": style}, device=device)
    names = "seconds_by_object", "nnfm_before", "nnfm_after"
    numbers = {name: round(scene.metrics[name]["vase"], 4) for name in names}
    yield numbers | {"precision": scene.metrics["precision"]}


def _test_rendering(device: str, scene: Scene, renders: int) -> dict[str, Any]:
    """Milliseconds of a picture at the photos' size, and its likeness to the reference's."""
    small, large = scene.working_views()[0][0], scene.cameras[0]
    splats = scene.splats.to(device)
    exact = replace(scene.splats, classifier=None, identities=None).map(torch.Tensor.double)
    expected, _, _ = rasterize(exact, small, backend="reference")
    error = (render(splats, small)[0].cpu() - expected[0]).square().mean().item()
    image = render(splats, large)[0].cpu()  # warm
    start = time.perf_counter()
    for _ in range(renders):
        image, _ = render(splats, large)
    image.cpu()  # waits for a GPU
    milliseconds = 1000 * (time.perf_counter() - start) / renders
    agreement = -10 * log10(max(error, 1e-20))
    return {"render_ms": round(milliseconds, 2), "agreement": round(agreement, 1)}


def _problem(row: dict[str, Any]) -> str | None:
    if not row["agreement"] >= LEAST_AGREEMENT:
        return f"its pictures agree with the reference rasteriser to {row['agreement']} dB only"
    if not row["psnr"] >= LEAST_FIT:
        return f"training leaves held-out photos at {row['psnr']:.1f} dB"
    if not row["nnfm_after"] < row["nnfm_before"]:
        return "painting does not bring the object closer to its style"
    return None
