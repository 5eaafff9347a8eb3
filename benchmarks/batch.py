"""What `stylesplat batch` gains over one job after another, and what Ray costs.

    .venv/bin/python benchmarks/batch.py SCENE [--objects 1,2,3,4] [--steps N] [--ray]

SCENE is that of the demo (`make demo` leaves it in `demo-output/scene`), in which four objects are
painted with four pictures each: 16 stylisations. They are run one after another with two threads,
then by two workers with one thread each; two of the results are compared, byte by byte, with
single runs of `stylesplat stylize` with one thread. `--ray` runs them once more as Ray tasks, on a
cluster of two cores that it starts. Target: 1.3 times the throughput, the same results, Ray 5 s and
5 % at most.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from bench import OUT, STYLES, calibration_ms, machine, table

import stylesplat
from stylesplat.demo.demo_run import copy_capture

PICTURES = 4
SINGLE = 2  # results that are compared with single runs
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
FOLDER = OUT / "batch"


def pictures() -> list[str]:
    """Four style pictures: the demo's three, and a painting."""
    shipped = copy_capture(FOLDER / "still_life") / "styles"
    found = [*sorted(shipped.iterdir()), *sorted(STYLES.glob("*.jpg"))]
    if len(found) < PICTURES:
        raise SystemExit(f"This benchmark needs the pictures in {STYLES}, which are not here.")
    return [str(path) for path in found[:PICTURES]]


def write_jobs(arguments: argparse.Namespace) -> Path:
    """A job file for all objects and pictures; JSON is YAML."""
    styles = [{name: pictures()} for name in arguments.objects.split(",")]
    options = {"style": styles, "quality": arguments.quality, "device": "cpu"}
    options |= {"steps": arguments.steps} if arguments.steps else {}
    scenes = {"demo": str(arguments.scene.resolve())}
    path = FOLDER / "jobs.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"scenes": scenes, "jobs": [{"stylize": options}]}))
    return path


def stylesplat_run(*arguments: object, threads: dict[str, str] | None = None) -> float:
    """Run a command; the seconds that it takes."""
    package = str(Path(stylesplat.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": package, **(threads or {})}
    start = time.monotonic()
    command = [sys.executable, "-m", "stylesplat", *map(str, arguments)]
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    return time.monotonic() - start


def batch(jobs: Path, name: str, *options: object) -> tuple[float, list[dict]]:
    """Run the jobs into a folder of their own; the seconds, and the journal."""
    out = FOLDER / name
    shutil.rmtree(out, ignore_errors=True)
    seconds = stylesplat_run("batch", jobs, "-o", out, *options)
    return seconds, [json.loads(line) for line in (out / "jobs.jsonl").read_text().splitlines()]


def same_as_alone(lines: list[dict], out: Path) -> bool:
    """Whether results are those of the same commands, run by themselves."""
    for line in lines[:: max(1, len(lines) // SINGLE)][:SINGLE]:
        words, alone = line["command"], FOLDER / "alone"
        words[words.index("-o") + 1] = alone
        stylesplat_run(*words, threads=ONE_THREAD)
        if (alone / "splats.ply").read_bytes() != (out / line["job"] / "splats.ply").read_bytes():
            return False
    return True


def row(name: str, seconds: float, lines: list[dict]) -> list[object]:
    """A line of the table."""
    alone, most = sum(line["seconds"] for line in lines), max(line["memory_gb"] for line in lines)
    each = f"{alone / len(lines):.1f} s"
    return [name, f"{seconds:.0f} s", each, f"{60 * len(lines) / seconds:.1f}", f"{most:.2f} GB"]


def main() -> None:
    """Run everything, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("--objects", default="1,2,3,4", help="names or ids")
    parser.add_argument("--quality", default="normal")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--ray", action="store_true")
    arguments = parser.parse_args()
    print(f"{machine()}, calibration loop {calibration_ms():.0f} ms", flush=True)
    jobs = write_jobs(arguments)
    one, in_turn = batch(jobs, "in_turn", "--workers", 1)
    two, at_once = batch(jobs, "at_once", "--workers", 2)
    rows = [row("one after another", one, in_turn), row("two workers", two, at_once)]
    same = same_as_alone(at_once, FOLDER / "at_once")
    three = None
    if arguments.ray:
        three, tasks = batch(jobs, "ray", "--ray", "local")
        rows.append(row("Ray, two cores", three, tasks))
    print(table(["how", "time", "a job", "jobs a minute", "memory of a job"], rows))
    print(f"\nThroughput: {one / two:.2f} times. Same as single runs: {'yes' if same else 'NO'}.")
    if three is not None:
        over = three - two
        print(f"Ray: {over:+.1f} s, {100 * over / two:+.1f} %; target 5 s + 5 %.")


if __name__ == "__main__":
    main()
