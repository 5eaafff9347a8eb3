"""Whether the same commands still make the same files, to the bit: what a change must keep.

    .venv/bin/python benchmarks/golden.py --keep     # before a change
    .venv/bin/python benchmarks/golden.py            # after it: names what differs, exit code 1

It trains a small splat of the demo's photos, selects objects by label and by click, paints two of
them, adjusts, exports, repaints a mesh and lifts masks, each by the command line on one thread
with seed 0. Digests hold for one machine and one set of libraries: keep them where they were made.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench import OUT

from stylesplat.demo.demo_run import copy_capture

KEPT = OUT / "golden.json"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
STYLES = "capture/styles"
COMMANDS = f"""
train capture -o scene --steps 400 --max-gaussians 15000 --downscale 2
select scene --name vase --id 1
select scene --name teapot --id 2 --no-picture
select scene --name pointed --point 001.jpg:178,126 --no-picture
select scene --name grown --id 1 --grow 0.05 --no-picture
stylize scene --style vase={STYLES}/swirling_night.jpg -o draft --quality draft
stylize draft --style teapot={STYLES}/burning_tide.jpg -o painted --steps 60
stylize scene --style vase=material:bronze -o bronze --steps 30 --form 0.5
adjust painted -o adjusted --intensity 0.6 --object vase
adjust painted -o undone --undo
export painted painted.sog
export painted vase.glb --mesh --object vase --repaint --faces 3000 --texture-size 256
train capture -o joint --steps 150 --max-gaussians 6000 --downscale 4 --segment joint
render painted -o labels --what labels --views test
export scene bare.ply --sh-degree 0
import bare.ply -o bare
select bare --name clicked --point view_000.png:480,420 --no-picture
mask boxed --box vase=001.jpg:215,43,335,236 --scene scene
"""  # the last one on photos without label maps


def run(folder: Path, source: Path, words: str) -> None:
    """Run one command in the folder with the package of this checkout."""
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(source)}
    command = [sys.executable, "-m", "stylesplat", *words.split()]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"stylesplat {words}: {done.stderr}")


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of each file that was made, but for those that hold paths, times or pictures."""
    suffixes = {".ply", ".safetensors", ".sog", ".glb", ".npz"}
    maps = {p for name in ("labels", "boxed/object_mask") for p in (folder / name).rglob("*.png")}
    files = {p for p in folder.rglob("*") if p.suffix in suffixes} | maps
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(files)
        if "capture" not in p.parts
    }


def made(folder: Path, source: Path) -> dict[str, str]:
    """Run all commands in the folder; the digests of what they make."""
    copy_capture(folder / "capture")
    copy_capture(folder / "boxed")
    for masks in (folder / "boxed").glob("object_*"):
        shutil.rmtree(masks) if masks.is_dir() else masks.unlink()
    for words in COMMANDS.strip().splitlines():
        start = time.monotonic()
        run(folder, source, words)
        print(f"{time.monotonic() - start:6.1f} s  {words}", flush=True)
    return digests(folder)


def main() -> None:
    """Make the files; keep their digests, or compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--keep", action="store_true", help="keep these digests as the right ones")
    parser.add_argument("--kept", type=Path, default=KEPT, help="file of the digests")
    arguments = parser.parse_args()
    source = Path(__file__).resolve().parents[1] / "src"
    with tempfile.TemporaryDirectory() as folder:
        found = made(Path(folder), source)
    if arguments.keep:
        arguments.kept.parent.mkdir(parents=True, exist_ok=True)
        arguments.kept.write_text(json.dumps(found, indent=1))
        return print(f"{len(found)} files; digests in {arguments.kept}")
    kept = json.loads(arguments.kept.read_text())
    wrong = [name for name in sorted({*kept, *found}) if kept.get(name) != found.get(name)]
    print(f"{len(kept)} files, {len(wrong)} differ" + "".join(f"\n  {name}" for name in wrong))
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
