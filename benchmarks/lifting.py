"""Label maps onto splats in closed form: how fast, how right; and how fast a large splat comes in.

    .venv/bin/python benchmarks/lifting.py

Targets: 50 views of 540x960 onto 50,000 Gaussians in 10 s; on the demo scene, corrupted label maps
in, a mean IoU of 0.95 in held-out views, lifted as well as trained jointly; a PLY of 1,000,000
Gaussians in 10 s and 2 GB.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import torch
from bench import (
    DATA,
    MIB,
    OUT,
    calibration_ms,
    capture,
    machine,
    peak_memory,
    resized,
    table,
    trained_scene,
)

import stylesplat as ss
from stylesplat.demo.demo_run import copy_capture
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.io.splats.splat_ply import write_splat_ply
from stylesplat.scene.splats import Splats
from stylesplat.training.lifting import lift
from stylesplat.training.views import split_views

GAUSSIANS, MANY = 50_000, 1_000_000


def fox_splats() -> Splats:
    """Fox at full size, trained once."""
    return ss.open(trained_scene("fox", downscale=1, gaussians=100_000)).splats


def speed() -> str:
    """Seconds of lifting fox's label maps at full size."""
    fox = capture("fox")
    splats = resized(fox_splats(), GAUSSIANS)
    lift(splats, fox, rows=[0])  # compiles
    start = time.perf_counter()
    lift(splats, fox)
    seconds = time.perf_counter() - start
    size = "x".join(map(str, fox.cameras.sizes[0].tolist()))
    return f"{len(fox.cameras)} views of {size} onto {len(splats):,} Gaussians: {seconds:.1f} s"


def quality() -> str:
    """IoU of the demo's held-out views, trained jointly and lifted."""
    folder = copy_capture(OUT / "demo")
    given, exact = ss.load(folder), ss.load(folder, masks=folder / "object_mask_exact")
    rows, held_out = split_views(given, 8)
    joint, apart = (
        ss.train(photos, max_seconds=seconds, max_gaussians=GAUSSIANS).splats
        for photos, seconds in ((given, 150.0), (replace(given, label_maps=None), 100.0))
    )
    lines = []
    for name, splats in (
        ("joint training, 150 s", joint),
        ("its Gaussians, labels lifted", lift(joint, given, rows=rows)),
        ("100 s without labels, then lifted", lift(apart, given, rows=rows)),
    ):
        found = evaluate_views(splats, exact, held_out)
        numbers = (f"{found[key]:.3f}" for key in ("miou", "boundary_miou"))
        lines.append([name, f"{found['psnr']:.2f}", *numbers])
    return table(["demo, exact masks", "PSNR", "mIoU", "boundary mIoU"], lines)


def import_large() -> str:
    """Seconds and memory of importing a large PLY without photos."""
    splats = fox_splats()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.ply"
        write_splat_ply(replace(resized(splats, MANY), identities=None, classifier=None), path)
        del splats
        start = time.perf_counter()
        memory = peak_memory(
            lambda: ss.save(ss.import_(path, device="cpu"), Path(folder) / "scene")
        )
        seconds = time.perf_counter() - start
    return f"import of {MANY:,} Gaussians: {seconds:.1f} s, {memory / MIB:.0f} MB at most"


def main() -> None:
    """Print the numbers."""
    print(f"{machine()}, calibration {calibration_ms():.0f} ms\n")
    torch.manual_seed(0)
    print(import_large(), end="\n\n", flush=True)
    if DATA.is_dir():
        print(speed(), end="\n\n", flush=True)
    print(quality())


if __name__ == "__main__":
    main()
