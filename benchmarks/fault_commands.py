"""The verbs as commands on a tiny scene, and whether what they leave is whole."""

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image

import stylesplat as ss
from ball_photos import write_ball_capture
from balls import CAMERAS, SPLATS
from corner_photos import corner, write_photos
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.scene.scene import Scene
from trials import PATHS

BOOT = 0.25  # seconds in which Python itself starts, and prints tracebacks of its own
PATIENCE = 180.0  # seconds for a command: a watchdog; kernels may have to be compiled
PROGRAM = (sys.executable, "-m", "stylesplat")
QUICK = ("--features", "compact", "--quality", "draft", "--device", "cpu")
STEPS = 60  # of training
# Of a scene, what follows from a command alone; other files hold times
TOLD = ("splats.ply", "picks.safetensors", "objects.json", "recipe.json", "layers.json", "base.ply")


@dataclass(frozen=True)
class Command:
    """A verb with its arguments, to be run in a copy of `make_place`'s folder."""

    verb: str
    arguments: tuple[str, ...]
    result: str
    """What it makes or changes."""
    whole: Callable[[Path], object]
    """Reads that; raises where it is not whole."""


def pictures(folder: Path) -> None:
    """All in a folder, or the one."""
    for path in folder.rglob("*.[pj][np]g") if folder.is_dir() else (folder,):
        with Image.open(path) as image:
            image.load()


def label_maps(folder: Path) -> None:
    capture = ss.load(folder.parent, masks=folder)
    for row in range(len(capture)):
        capture.labels(row)


COMMANDS = (
    Command(
        "train",
        ("capture", "-o", "trained", "--steps", str(STEPS), "--max-gaussians", "500"),
        "trained",
        ss.open,
    ),
    Command("sfm", ("photos", "-o", "posed"), "posed", ss.load),
    Command("mask --from", ("capture", "--from", "masks"), "capture/object_mask", label_maps),
    Command(
        "mask --box",
        ("capture", "--box", "red=0000.jpg:2,8,22,30", "--scene", "scene"),
        "capture/object_mask",
        label_maps,
    ),
    Command("import", ("a.ply", "capture", "-o", "imported"), "imported", ss.open),
    Command("select", ("scene", "--name", "pot", "--id", "3"), "scene", ss.open),
    Command(
        "stylize",
        ("scene", "--style", "3=wave.png", "-o", "painted", "--steps", "4", *QUICK),
        "painted",
        ss.open,
    ),
    Command("adjust", ("styled", "--intensity", "0.3"), "styled", ss.open),
    Command(
        "sheet",
        ("scene", "--style", "3=wave.png", "--vary", "scale=1,2", "--steps", "2", "-o", "s.png"),
        "s.png",
        pictures,
    ),
    Command("render", ("scene", "-o", "views"), "views", pictures),
    Command("export", ("scene", "out.ply"), "out.ply", read_splats),
    Command("evaluate", ("scene",), "scene", ss.open),
    Command("objects", ("scene",), "scene", ss.open),
)
REPLACING = {"sfm", "train", "mask", "import", "stylize", "sheet", "render", "export"}
"""The verbs that take `--overwrite`."""


def make_place(folder: Path) -> Path:
    """Photos, a capture, masks, a scene, a styled scene, a splat and a picture, all tiny."""
    capture = write_ball_capture(folder / "capture")
    shutil.copytree(capture / "object_mask", folder / "masks")
    write_photos(folder / "photos", corner(4))
    scene = Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:1], capture=Path("capture"))
    ss.save(scene, folder / "scene")
    ss.export(scene, folder / "a.ply")
    stripes = 200 * (torch.arange(96) // 6 % 2).to(torch.uint8)
    pixels = torch.stack([stripes, 90 + 0 * stripes, 255 - stripes], dim=-1)
    Image.fromarray(pixels[:, None].expand(96, 96, 3).numpy()).save(folder / "wave.png")
    stylize = next(command for command in COMMANDS if command.verb == "stylize")
    done = run(stylize, folder)
    if done.returncode:
        raise SystemExit(f"The suite cannot make its scene: {done.stderr}")
    (folder / "painted").rename(folder / "styled")
    return folder


def line_of(command: Command, program: Sequence[str] = PROGRAM) -> list[str]:
    """What a shell would be given."""
    verb = command.verb.partition(" ")[0]
    overwrite = ["--overwrite"] if verb in REPLACING else []
    return [*program, verb, *command.arguments, *overwrite]


def environment(**others: str) -> dict[str, str]:
    """One thread each, so that commands run beside each other; the tree that this file is of."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    return os.environ | threads | {"PYTHONPATH": os.pathsep.join(map(str, PATHS))} | others


def start(
    command: Command, folder: Path, program: Sequence[str] = PROGRAM, **others: str
) -> subprocess.Popen[str]:
    """Begin a command in a folder."""
    return subprocess.Popen(
        line_of(command, program),
        cwd=folder,
        env=environment(**others),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )


def run(
    command: Command, folder: Path, program: Sequence[str] = PROGRAM, **others: str
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; raises subprocess.TimeoutExpired where it hangs."""
    return finish(start(command, folder, program, **others))


def finish(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    """Wait for a command; what it said comes along."""
    try:
        said = process.communicate(timeout=PATIENCE)[1]
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return subprocess.CompletedProcess(process.args, process.returncode, stderr=said)


def state(path: Path) -> str:
    """A digest of what a command makes: of a scene, of what follows from the command alone."""
    if (path / "sfm.json").exists():  # poses differ in their last bits, and times
        return repr(sorted(str(file.relative_to(path)) for file in path.rglob("*")))
    names = [path / name for name in TOLD] if (path / "scene.json").exists() else path.rglob("*")
    files = [path] if path.is_file() else sorted(file for file in names if file.is_file())
    digests = [(str(file), hashlib.sha256(file.read_bytes()).hexdigest()) for file in files]
    return repr([(Path(name).relative_to(path.parent).as_posix(), it) for name, it in digests])


def fault_of(command: Command, folder: Path, known: Sequence[str] = ()) -> str | None:
    """Why what a command left is neither old nor new; None if it is.

    Args:
        command: Which one.
        folder: Where it ran.
        known: The states it may have; empty if any that can be read will do.
    """
    path = folder / command.result
    if not path.exists():
        return "it is gone" if known and "absent" not in known else None
    try:
        command.whole(path)
    except (StyleSplatError, OSError, ValueError) as error:
        return f"it cannot be read: {error}"
    return "it is neither old nor new" if known and state(path) not in known else None


def leftovers(folder: Path) -> list[str]:
    """Hidden and unfinished things that nobody needs any more."""
    found = folder.rglob("*")
    return sorted(p.name for p in found if p.name.startswith(".") or p.name.endswith(".partial"))


def described_end(done: subprocess.CompletedProcess[str], codes: Sequence[int]) -> str | None:
    """What is wrong with how a command ended; None if nothing is."""
    for word in ("Traceback", "Aborted", "Fatal Python", "terminate called"):
        if word in done.stderr:
            return f"{word}: {done.stderr.strip().splitlines()[-1][:200]}"
    if done.returncode not in codes:
        last = done.stderr.strip().splitlines()[-1:]
        return f"exit status {done.returncode}, expected {codes}: {last}"
    return None
