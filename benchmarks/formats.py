"""What each format of splats costs and keeps: bytes a Gaussian, largest errors, seconds, memory.

    .venv/bin/python benchmarks/formats.py SCENE
    npm install --prefix DIR @playcanvas/splat-transform
    .venv/bin/python benchmarks/formats.py SCENE --splat-transform DIR

With PlayCanvas's splat-transform, it reads what we write and writes PLY of it, whose values are
compared with what we read; and we read what it writes of a thousand Gaussians (on a CPU it takes
seconds for a thousand of them, twenty minutes for a hundred thousand).
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch
from bench import machine, table

from stylesplat.io.splats.splat_files import read_splats, row_order, write_splats
from stylesplat.scene.splats import Splats

SUFFIXES = (".ply", ".compressed.ply", ".spz", ".splat", ".sog", ".glb")
FEW = 1000
# What two readers of the same file may differ by: float32 beside float64; for splat-transform the
# bytes of a rotation in .splat are steps of 1 / 127.5, for us and its first reader of 1 / 128
SAME = {
    "place": 1e-3,
    "size": 1e-4,
    "rotation": 1.0,
    "opacity": 1e-4,
    "colour": 1e-3,
    "bands": 1e-3,
}


def errors(found: Splats, wanted: Splats) -> dict[str, float]:
    """The largest of each kind, row by row: relative places, logarithms, degrees and so on."""
    normal = torch.nn.functional.normalize
    turns = (
        (normal(found.quats.double(), dim=1) * normal(wanted.quats.double(), dim=1))
        .sum(dim=1)
        .abs()
    )
    bands = min(found.shN.shape[1], wanted.shN.shape[1])
    missing = wanted.shN[:, bands:].abs()
    return {
        "place": float(((found.means - wanted.means).norm(dim=1) / reach(wanted)).max()),
        "size": float((found.scales - wanted.scales).abs().max()),
        "rotation": float(torch.rad2deg(2 * turns.clamp(max=1).arccos()).max()),
        "opacity": float((found.opacities.sigmoid() - wanted.opacities.sigmoid()).abs().max()),
        "colour": float((found.sh0 - wanted.sh0).abs().max()),
        "bands": max(
            float((found.shN[:, :bands] - wanted.shN[:, :bands]).abs().max()) if bands else 0.0,
            float(missing.max()) if missing.numel() else 0.0,
        ),
    }


def reach(splats: Splats) -> torch.Tensor:
    """How far each Gaussian is from the middle, at least the median of that."""
    away = (splats.means - splats.means.median(dim=0).values).norm(dim=1)
    return away.clamp(min=float(away.median()))


def told(name: str, values: dict[str, float]) -> list[str]:
    return [name, *(f"{value:.3g}" for value in values.values())]


def kept(splats: Splats, folder: Path) -> None:
    rows = []
    for suffix in SUFFIXES:
        path = folder / f"a{suffix}"
        start = time.perf_counter()
        write_splats(splats, path)
        written = time.perf_counter()
        found = read_splats(path)
        seconds = f"{written - start:.1f} / {time.perf_counter() - written:.1f}"
        each = path.stat().st_size / len(splats)
        rows.append(
            [*told(suffix, errors(found, splats[row_order(splats, path)])), f"{each:.1f}", seconds]
        )
    print(table(["format", *SAME, "bytes each", "write / read, s"], rows))


def other(program: Path, source: Path, target: Path) -> None:
    command = ["node", program, "-g", "cpu", "-w", "-q", source, target]
    subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)


def agree(program: Path, splats: Splats, folder: Path) -> bool:
    """Whether splat-transform reads our files as we do, and we its files as it does."""
    few, rows, fine = folder / "few.ply", [], True
    write_splats(splats[torch.arange(0, len(splats), max(1, len(splats) // FEW))], few)
    for suffix in SUFFIXES[1:-1]:  # .ply is what is compared, .glb it does not read
        for writer in ("ours", "theirs"):
            if (suffix, writer) == (".splat", "theirs"):
                continue  # which it does not write
            path = folder / f"a{suffix}" if writer == "ours" else folder / f"{writer}{suffix}"
            if writer == "theirs":
                other(program, few, path)
            other(program, path, folder / "back.ply")
            found = errors(read_splats(folder / "back.ply"), read_splats(path))
            fine &= all(found[kind] <= most for kind, most in SAME.items())
            rows.append(told(f"{suffix}, {writer}", found))
    print(table(["read by both", *SAME], rows))
    return fine


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, help="a folder with splats.ply, or a file of splats")
    parser.add_argument("--splat-transform", type=Path, help="where npm has installed it")
    args = parser.parse_args()
    source = args.scene / "splats.ply" if args.scene.is_dir() else args.scene
    splats = read_splats(source)
    print(machine(), f"{len(splats):,} Gaussians of degree {splats.sh_degree}", sep="\n")
    with tempfile.TemporaryDirectory() as name:
        kept(splats, Path(name))
        if args.splat_transform is None:
            print("splat-transform: not compared, --splat-transform says where it is.")
            return
        package = args.splat_transform / "node_modules/@playcanvas/splat-transform"
        sys.exit(not agree(package / "bin/cli.mjs", splats, Path(name)))


if __name__ == "__main__":
    main()
