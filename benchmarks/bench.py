"""What the benchmarks share: scenes, clocks, memory and tables."""

import math
import platform
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

import numba
import torch

import stylesplat as ss
from stylesplat.errors import count_noun
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features import FeatureNetwork, load_weights

sys.path.append(str(Path(__file__).resolve().parents[1] / "scripts"))  # still_life is there
ABOVE = Path(__file__).resolve().parents[2:]  # of the repository, which may be a worktree
DATA = next(
    (p for p in (up / "shared" / "data" for up in ABOVE) if p.is_dir()),
    ABOVE[0] / "shared" / "data",
)
STYLES = DATA / "styles"
VGG19 = DATA.parent / "weights" / "vgg19_conv1_1-conv3_4.safetensors"
OUT = Path(__file__).resolve().parent / "out"
MIB = 2**20


def posed(scene: Path) -> Path:
    """A scene's capture; photos are posed once. Exits with a reason where the scene is absent."""
    kept = OUT / f"{scene.name}_capture"
    if not scene.is_dir():
        raise SystemExit(f"This benchmark needs the scene {scene}, which is not here.")
    if not (scene / "photos").is_dir():
        return scene
    if not kept.exists():
        ss.sfm(scene / "photos", kept)
    return kept


def capture_of(scene: Path, downscale: float = 1.0) -> Capture:
    """A scene with the masks that it is judged by."""
    masks = scene / "masks"
    return ss.load(posed(scene), masks=masks if masks.is_dir() else None, downscale=downscale)


def capture(name: str, downscale: float = 1.0, *, identities: bool = True) -> Capture:
    """A real scene of the development data; exits with a reason where it is absent."""
    loaded = capture_of(DATA / name, downscale)
    return loaded if identities else replace(loaded, label_maps=None)


def trained_scene(name: str, *, downscale: float, gaussians: int, seconds: float = 200.0) -> Path:
    """A real scene with its objects, trained once and kept in `benchmarks/out`."""
    folder = OUT / f"{name}_{downscale:g}_{gaussians}"
    if not folder.exists():
        photos = capture(name, downscale)
        ss.save(ss.train(photos, max_seconds=seconds, max_gaussians=gaussians), folder)
    return folder


def style_network(depth: int = 3) -> FeatureNetwork:
    """The development copy of VGG19; exits with a reason where it is absent."""
    if not VGG19.is_file():
        raise SystemExit(f"This benchmark needs the weights {VGG19}, which are not here.")
    return load_weights("vgg19", VGG19, depth=depth)


def resized(splats: Splats, count: int) -> Splats:
    """Fewer Gaussians at random, or more: copies beside the originals, smaller by their number."""
    n, generator = len(splats), torch.Generator().manual_seed(0)
    if count <= n:
        return splats[torch.randperm(n, generator=generator)[:count]]
    rows = torch.arange(count) % n
    more = splats[rows]
    scales = more.scales - math.log(count / n) / 3
    jitter = torch.randn(count, 3, generator=generator) * more.scales.exp()
    return replace(more, means=more.means + jitter, scales=scales)


def calibration_ms() -> float:
    """Milliseconds of a fixed loop: 20 products of two 512 x 512 matrices, 2.7 G multiply-adds.

    It tells how fast, and how quiet, the machine was at that moment.
    """
    matrix = torch.full((512, 512), 0.5)
    return median_ms(lambda: [matrix @ matrix for _ in range(20)], repeats=5, warm_up=1)


def median_ms(work: Callable[[], object], repeats: int = 15, warm_up: int = 3) -> float:
    """Median wall time of some work in milliseconds, after a few runs that do not count."""
    for _ in range(warm_up):
        work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - start))
    return median(times)


def processor_ms(work: Callable[[], object], repeats: int = 15) -> float:
    """Mean time of all threads together, which other processes lengthen less than wall time."""
    start = time.process_time()
    for _ in range(repeats):
        work()
    return 1e3 * (time.process_time() - start) / repeats


def peak_memory(work: Callable[[], object]) -> int:
    """The most resident bytes of this process while it does some work (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")  # forget earlier peaks
    work()
    return _status("VmHWM")


def _status(field: str) -> int:
    found = re.search(rf"{field}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return 1024 * int(found[1])


def machine() -> str:
    """The processor and its threads, for the head of a report."""
    found = re.search(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text())
    threads = count_noun(numba.get_num_threads(), "thread")
    return f"{found[1] if found else platform.processor()}, {threads}"


def table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)
