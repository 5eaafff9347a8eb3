"""All checks that need an NVIDIA GPU, in one command, on a machine that may have no network.

    python benchmarks/gpu.py --wheels wheels/ --fox ../shared/data/fox

The machine needs torch and a GPU; rows that are marked so compare gsplat, where it is installed.
`--wheels` is a folder of wheels, made where there is a network by
`pip download -d wheels '.[gsplat]' hatchling` (leave torch's out if the machine has its own); what
is missing is installed from it. gsplat needs nvcc, and compiles its kernels when it is first used.
Prints

1. correctness: images and gradients of each backend against the float64 reference;
2. frames per second at 1920x1080, of 100,000 (target: 300) and 1,000,000 Gaussians, and
   milliseconds with the backward pass, of the colours alone and with 16 identities;
3. fox, 7000 joint steps: seconds (target: 45), held-out PSNR and IoU; seconds of lifting its label
   maps; milliseconds of a step of colours, and of the same step by gsplat's rasteriser and torch's
   Adam, as gsplat's own trainer takes it; 30,000 steps on the paper's settings, reckoned from 600
   whose schedules are as long;
4. where `--lego` names it, NeRF's lego, 30,000 steps (target: 360 s, and 35.5 dB or more);
5. fox painted in 300 steps with the compact network and, where `--vgg19` names its weights, VGG19;
   where `--vgg16` does, in 500 steps as published (target: 8 s);
6. each of these figures as soon as it is known, beside the one that docs/scale.md derives for an
   H100, with the peak of the GPU's memory. Where they differ by more than 2, read that derivation
   first.

Everything timed has run once before, so that no figure counts the loading of libraries. A figure
that fails shows its error, and the others follow. It takes 4 minutes on an H100, and exits with 1
if correctness or a figure fails.
"""

import argparse
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

    from stylesplat.rendering.render import Backend
    from stylesplat.scene.cameras import Cameras
    from stylesplat.scene.capture import Capture
    from stylesplat.scene.scene import Scene
    from stylesplat.scene.splats import Splats
    from stylesplat.stylization.config import Network, StyleConfig
    from stylesplat.training.config import TrainConfig
    from stylesplat.training.views import TrainingViews

ROOT = Path(__file__).resolve().parents[1]
IMAGE_TOLERANCE = 1e-3  # float32; gsplat orders ties in depth as it likes
GRADIENT_TOLERANCE = 1e-3  # relative L2, DESIGN's bound for float32 kernels
FRAMES = 300
STEPS = 200
PAPER_STEPS = 600
REFINEMENTS = 30  # of those; 300 of 30,000 steps take as small a share of the time
EXPECTED = {  # on an H100, derived in docs/scale.md
    "100,000 Gaussians, frames per second": 300.0,
    "1,000,000 Gaussians, frames per second": 130.0,
    "fox, 7000 steps, s": 45.0,
    "fox, lifting its label maps, s": 1.0,
    "fox, a step of colours, ms": 4.5,
    "fox, the same by gsplat and torch, ms": 4.5,
    "fox, 30,000 steps of the paper, s": 400.0,
    "lego, 30,000 steps, s": 360.0,
    "fox, 300 steps of compact, s": 3.0,
    "fox, 300 steps of vgg19, s": 6.0,
    "fox, 500 steps of vgg16 as published, s": 8.0,
}


def install(wheels: Path | None) -> None:
    """Make `stylesplat` importable, and gsplat where it is, from the folder of wheels if given."""
    sys.path.insert(0, str(ROOT / "src"))
    if wheels is not None:
        pip = [sys.executable, "-m", "pip", "install", "--no-index", "--find-links", str(wheels)]
        subprocess.run([*pip, "hatchling"], check=True)
        subprocess.run([*pip, "--no-build-isolation", str(ROOT)], check=True)
        subprocess.run([*pip, "gsplat"], check=False)


def cloud(count: int, size: float, seed: int = 0) -> "Splats":
    """Random Gaussians in the cube from -1 to 1, with identities; `size` in log units."""
    import torch

    from stylesplat.scene.splats import Splats

    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    return Splats(
        means=2 * torch.rand(count, 3, generator=generator) - 1,
        quats=normal(count, 4),
        scales=0.4 * normal(count, 3) + size,
        opacities=2 * normal(count),
        sh0=normal(count, 1, 3),
        shN=0.2 * normal(count, 15, 3),
        identities=normal(count, 16),
    )


def camera(width: int, height: int) -> "Cameras":
    """A view of the cube from three units away."""
    import torch

    from stylesplat.scene.cameras import Cameras

    viewmat = torch.eye(4)
    viewmat[2, 3] = 3.0
    focal = 0.9 * width
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Cameras(viewmat[None], K[None], torch.tensor([[width, height]]), ("view",))


def gradients(
    splats: "Splats", backend: "Backend", dtype: "torch.dtype"
) -> dict[str, "torch.Tensor"]:
    """The image of a view and the gradients of a random function of it, as float64."""
    import torch

    from stylesplat.rendering.render import rasterize

    tensors = splats.tensors()
    leaves = {name: t.to(dtype).requires_grad_() for name, t in tensors.items()}
    attached = replace(splats, **leaves)
    image, alphas, _ = rasterize(
        attached, camera(200, 120), features=attached.identities, backend=backend
    )
    weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(1)).to(image)
    ((image * weights).sum() + alphas.sum()).backward()
    found = {name: leaf.grad for name, leaf in leaves.items()} | {"image": image}
    return {name: t.detach().cpu().double() for name, t in found.items() if t is not None}


def backends() -> "list[Backend]":
    """Ours, and gsplat where it is installed."""
    return ["cuda", "gsplat"] if find_spec("gsplat") else ["cuda"]


@contextmanager
def rendering_by(backend: "Backend") -> Iterator[None]:
    """Let everything on a GPU be rendered by a backend."""
    from stylesplat.rendering import reference

    before, reference.ON_GPU = reference.ON_GPU, backend
    try:
        yield
    finally:
        reference.ON_GPU = before


def check_correctness(backend: "Backend") -> bool:
    """Print the error of the image and of every gradient; True if all are small."""
    import torch

    splats = cloud(500, -2.5)
    expected = gradients(splats, "reference", torch.float64)
    given = gradients(splats.to("cuda"), backend, torch.float32)
    good = True
    for name, truth in expected.items():
        error = float((given[name] - truth).norm() / truth.norm())
        bound = IMAGE_TOLERANCE if name == "image" else GRADIENT_TOLERANCE
        good &= error < bound
        print(
            f"  {backend:8s}{name:12s} relative L2 error {error:.1e} "
            f"{'ok' if error < bound else 'TOO LARGE'}"
        )
    return good


def milliseconds(step: Callable[[], object], count: int) -> float:
    """Milliseconds of a call that uses the GPU: the mean of `count`, after some to warm up."""
    import torch

    for _ in range(min(20, count)):
        step()
    torch.cuda.synchronize()
    start = time.perf_counter()
    for _ in range(count):
        step()
    torch.cuda.synchronize()
    return 1000 * (time.perf_counter() - start) / count


def frame_rate(count: int, frames: int = FRAMES) -> float:
    """Frames per second of so many Gaussians at 1920x1080."""
    import torch

    from stylesplat.rendering.render import rasterize

    splats, view = cloud(count, -5.5).to("cuda"), camera(1920, 1080).to("cuda")
    with torch.no_grad():
        return 1000 / milliseconds(lambda: rasterize(splats, view), frames)


def gradient_time(count: int, size: tuple[int, int], features: int) -> float:
    """Milliseconds of an image and its gradients, with so many channels beside colours: 0 or 16."""
    from stylesplat.rendering.render import rasterize

    splats, view = cloud(count, -5.5).to("cuda"), camera(*size).to("cuda")
    leaves = {name: tensor.requires_grad_() for name, tensor in splats.tensors().items()}
    attached = replace(splats, **leaves)

    def step() -> None:
        more = attached.identities if features else None
        image, _, _ = rasterize(attached, view, features=more)
        image.sum().backward()
        for leaf in leaves.values():
            leaf.grad = None

    return milliseconds(step, STEPS)


def lift_labels(scene: "Scene", fox: "Capture") -> float:
    """Seconds of lifting the capture's label maps onto the scene; they are decoded anew."""
    import stylesplat as ss

    start = time.perf_counter()
    ss.labels(scene, fox, device="cuda")
    return time.perf_counter() - start


def train_and_judge(capture: "Capture", config: "TrainConfig") -> "tuple[Scene, float]":
    """Print the quality of a training; returns the scene and the seconds."""
    from stylesplat.evaluation.photos import evaluate_views
    from stylesplat.scene.scene import Scene
    from stylesplat.training.loop import fit
    from stylesplat.training.views import split_views

    state = fit(capture, config, device="cuda")
    _, held_out = split_views(capture, config.test_every)
    splats = state.splats.detach()
    metrics = evaluate_views(splats, capture, held_out, background=config.background)
    print(f"  {state.seconds:.1f} s, {len(splats):,} Gaussians, {metrics}")
    held = tuple(capture.cameras.names[row] for row in held_out)
    return Scene(splats.to("cpu"), capture.cameras, held_out=held), state.seconds


def train_fox(fox: "Capture", steps: int = 7000) -> "tuple[Scene, float]":
    """Joint steps."""
    from stylesplat.training.config import TrainConfig

    return train_and_judge(fox, TrainConfig(steps=steps, identity_every=1))


def train_lego(lego: "Capture", steps: int = 30_000) -> float:
    """Seconds of steps of colours before white."""
    from stylesplat.training.config import TrainConfig

    return train_and_judge(lego, TrainConfig(steps=steps, background="white"))[1]


def train_as_paper(fox: "Capture", steps: int = PAPER_STEPS) -> float:
    """Seconds of 30,000 steps on the paper's settings, from fewer with as many Gaussians."""
    from stylesplat.training.config import TRAIN_PRESETS
    from stylesplat.training.loop import fit

    paper = TRAIN_PRESETS["paper"]
    assert paper.sh_degree_every is not None
    shorter = replace(
        paper,
        steps=steps,
        refine_every=max(1, steps // REFINEMENTS),
        sh_degree_every=max(1, paper.sh_degree_every * steps // paper.steps),
    )
    return fit(fox, shorter, device="cuda").seconds * paper.steps / steps


def decoded(fox: "Capture") -> "TrainingViews":
    """The photos of a capture, all of them decoded."""
    import torch

    from stylesplat.training.views import TrainingViews

    views = TrainingViews(fox, range(len(fox)), ids=(), device=torch.device("cuda"))
    for row in range(len(fox)):
        views(row, 1)
    return views


def step_of_colors(fox: "Capture", splats: "Splats") -> Callable[[], object]:
    """A function that takes a step of ours on splats, without identities and growth."""
    import torch

    from stylesplat.scene.outliers import scene_extent
    from stylesplat.training.config import TrainConfig
    from stylesplat.training.densification import MCMCStrategy
    from stylesplat.training.state import TrainingRun, first_state
    from stylesplat.training.step import train_step

    config = TrainConfig(steps=10**6, refine_every=10**6, coarse_to_fine=False, sh_degree_every=1)
    device, rows, extent = torch.device("cuda"), range(len(fox)), scene_extent(fox.cameras)
    strategy = MCMCStrategy(config, extent)
    run = TrainingRun(config, tuple(rows), decoded(fox), fox.cameras, extent, device, strategy)
    state = first_state(replace(splats, identities=None, classifier=None).to(device))

    def step() -> None:
        nonlocal state
        state, _ = train_step(run, state)

    return step


def step_of_gsplat(fox: "Capture", splats: "Splats") -> Callable[[], object]:
    """A function that takes a step by gsplat's rasteriser and torch's Adam: the same losses."""
    import gsplat
    import torch

    from stylesplat.training.losses import photometric_reference

    views, row = decoded(fox), 0
    given = replace(splats, identities=None, classifier=None).to("cuda").tensors()
    leaves = {name: tensor.clone().requires_grad_() for name, tensor in given.items()}
    adams = [torch.optim.Adam([leaf], lr=1e-4, eps=1e-15, fused=True) for leaf in leaves.values()]

    def step() -> None:
        nonlocal row
        view, row = views(row, 1), (row + 1) % len(fox)
        width, height = view.camera.size
        scales, opacities = leaves["scales"].exp(), leaves["opacities"].sigmoid()
        image, _, _ = gsplat.rasterization(
            leaves["means"],
            leaves["quats"],
            scales,
            opacities,
            torch.cat([leaves["sh0"], leaves["shN"]], dim=1),
            view.camera.viewmats,
            view.camera.Ks,
            width,
            height,
            sh_degree=splats.sh_degree,
            packed=False,
        )
        loss, _ = photometric_reference(image[0], view.photo)
        (loss + 0.01 * opacities.mean() + 0.01 * scales.mean()).backward()
        for adam in adams:
            adam.step()
            adam.zero_grad()

    return step


def paint_fox(
    scene: "Scene", style: Path, features: "Network", weights: Path | None, config: "StyleConfig"
) -> float:
    """Seconds of painting the first object of the fox."""
    import stylesplat as ss
    from stylesplat.scene.capture import BACKGROUND

    assert scene.splats.classifier is not None
    name = str(min({*scene.splats.classifier.ids} - {BACKGROUND}))
    start = time.perf_counter()
    ss.stylize(
        scene,
        {name: ss.Style(style, config=config)},
        features=features,
        weights=weights,
        device="cuda",
        measured=False,
    )
    return time.perf_counter() - start


@dataclass
class Table:
    """Figures, each printed beside the one expected as soon as it is known."""

    missing: list[str] = field(default_factory=list)
    """What could not be measured."""

    def check(self, backend: "Backend") -> None:
        """Check whether a backend is correct."""
        try:
            is_correct = check_correctness(backend)
        except Exception:
            traceback.print_exc(file=sys.stdout)
            is_correct = False
        if not is_correct:
            self.missing.append(f"a correct {backend}")

    def row(self, name: str, measure: Callable[[], float], backend: "Backend" = "cuda") -> None:
        """Measure a figure and print it, or the error that it ends with."""
        import torch

        torch.cuda.reset_peak_memory_stats()
        title = name if backend == "cuda" else f"{name} ({backend})"
        try:
            with rendering_by(backend):
                value = measure()
        except Exception:
            traceback.print_exc(file=sys.stdout)
            self.missing.append(title)
            return
        peak = torch.cuda.max_memory_allocated() / 2**30
        expected = EXPECTED.get(name)  # else backends are compared with each other
        ratio = f"{expected:9.1f}{value:9.1f}{value / expected:7.2f}" if expected else ""
        figures = f"{ratio or f'{value:18.1f}':25}{peak:7.2f} GiB"
        print(f"{title:50}{figures}", flush=True)


def of_fox(
    table: Table, fox: "Capture", style: Path, vgg16: Path | None, vgg19: Path | None
) -> None:
    """The rows of one capture: training, a step, and painting."""
    from stylesplat.stylization.config import STYLE_PRESETS, StyleConfig

    scenes: list[Scene] = []

    def train() -> float:
        train_fox(fox, steps=20)  # to warm up
        scene, seconds = train_fox(fox)
        scenes.append(scene)
        return seconds

    table.row("fox, 7000 steps, s", train)
    if not scenes:
        return  # all else needs the trained fox
    (scene,) = scenes

    def lift() -> float:
        lift_labels(scene, fox)  # to warm up
        return lift_labels(scene, fox)

    table.row("fox, lifting its label maps, s", lift)
    for backend in backends():
        step = "fox, a step of colours, ms"
        table.row(step, lambda: milliseconds(step_of_colors(fox, scene.splats), STEPS), backend)
    if "gsplat" in backends():
        step = "fox, the same by gsplat and torch, ms"
        table.row(step, lambda: milliseconds(step_of_gsplat(fox, scene.splats), STEPS))
    table.row("fox, 30,000 steps of the paper, s", lambda: train_as_paper(fox))
    short, draft = StyleConfig(steps=300), StyleConfig(quality="draft")  # this to warm up

    def paint(
        name: str,
        network: "Network",
        weights: Path | None,
        config: StyleConfig,
        backend: "Backend" = "cuda",
    ) -> None:
        def measure() -> float:
            paint_fox(scene, style, network, weights, draft)
            return paint_fox(scene, style, network, weights, config)

        table.row(name, measure, backend)

    for backend in backends():
        paint("fox, 300 steps of compact, s", "compact", None, short, backend)
    if vgg19 is not None:
        paint("fox, 300 steps of vgg19, s", "vgg19", vgg19, short)
    if vgg16 is not None:
        paint("fox, 500 steps of vgg16 as published, s", "vgg16", vgg16, STYLE_PRESETS["paper"])


def main() -> int:
    """Run the checks, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--wheels", type=Path, help="folder of wheels for a machine offline")
    parser.add_argument("--fox", type=Path, default=ROOT.parent / "shared/data/fox")
    parser.add_argument("--lego", type=Path, help="folder of nerf_synthetic/lego")
    parser.add_argument("--style", type=Path, help="a picture, in place of a built-in one")
    parser.add_argument("--vgg16", type=Path, help="file of VGG16's weights")
    parser.add_argument("--vgg19", type=Path, help="file of VGG19's weights")
    options = parser.parse_args()
    install(options.wheels)
    import stylesplat as ss  # before torch, whose threads it sets up

    import torch  # isort: skip
    from stylesplat.demo.demo_run import STYLES, copy_capture

    if not torch.cuda.is_available():
        raise SystemExit("There is no NVIDIA GPU here, or torch cannot use it.")
    print(torch.cuda.get_device_name(), "\ncorrectness")
    table = Table()
    for backend in backends():
        table.check(backend)
    print(f"{'':50}{'expected':>9}{'measured':>9}{'ratio':>7}{'memory':>7}")
    for count in (10**5, 10**6):
        name = f"{count:,} Gaussians, frames per second"
        for backend in backends():
            table.row(name, lambda count=count: frame_rate(count), backend)
    for name, *given in (
        ("1920x1080, 1,000,000, forward and backward, ms", 10**6, (1920, 1080), 0),
        ("the same with 16 identities, ms", 10**6, (1920, 1080), 16),
        ("540x960, 100,000, forward and backward, ms", 10**5, (540, 960), 0),
    ):
        for backend in backends():
            table.row(name, partial(gradient_time, *given), backend)
    if options.fox.is_dir():
        with tempfile.TemporaryDirectory() as folder:
            built_in = copy_capture(Path(folder) / "capture") / "styles" / f"{STYLES['vase']}.jpg"
            style = options.style or built_in
            of_fox(table, ss.load(options.fox), style, options.vgg16, options.vgg19)
    else:
        print(f"fox is left out: {options.fox} is not here; pass --fox")
    if options.lego:
        table.row("lego, 30,000 steps, s", lambda: train_lego(ss.load(options.lego)))
    if table.missing:
        print("not measured: " + "; ".join(table.missing))
    return 1 if table.missing else 0


if __name__ == "__main__":
    sys.exit(main())
