"""Time and memory of the commands on very large splats, and on scenes of very many objects.

    .venv/bin/python benchmarks/large.py SCENE [--gaussians 10000000] [-o DIR] [--only select,...]
    .venv/bin/python benchmarks/large.py SCENE --labels 1000 [--gaussians 1000000]

SCENE is a trained one with objects, such as fox. What it is of is made finer, by copies of
Gaussians beside the originals, until its largest object has about 200,000; copies of that stand on
a grid. With `--labels` it stands there once, as fine as is wanted and cut into so many pieces, each
an object, and the 5, 20 and 50 that show best are painted. Every command is a process of its own;
its seconds (start of Python included), those of all cores together, which other programs lengthen
less, and its most resident memory are told. DIR keeps what they make. Targets with ten million
Gaussians: import 60 s, select by point 5 s besides the start, stylize 3 min, export 30 s, 12 GB.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from stylesplat.scene.cameras import Cameras
    from stylesplat.scene.splats import Splats

HERE = Path(__file__).resolve().parent
OBJECT = 200_000  # Gaussians that the painted object has, about
GIB = 2**30
STARTED = "import stylesplat.verbs.select, stylesplat.io.scene_folder"
PAINTED = (5, 20, 50)  # objects in one run
CANDIDATES = 300  # objects whose pixels are counted in a view
VIEWS = (0, 9, 18, 27)  # of those around a splat without photos


@dataclass(frozen=True)
class Grid:
    """What the splat is made of."""

    scene: Path
    gaussians: int
    labels: int

    def make(self, folder: Path) -> None:
        """Write the splat, the label of each Gaussian, and where one object stands."""
        import torch
        from bench import resized

        import stylesplat as ss
        from stylesplat.scene.content import content_of, extent_of
        from stylesplat.selection.identities import class_probabilities

        splats = ss.open(self.scene).splats
        extent = content_of(splats).extent
        inside = ((splats.means >= extent.low) & (splats.means <= extent.high)).all(dim=1)
        splats = splats[inside]
        if self.labels:
            many = resized(splats, self.gaussians)
            labels = pieces(many, self.labels)
            facts = {"gaussians": len(many), "objects": self.labels}
            return self.write(folder, many, labels, facts | {"seen": most_solid(many, labels)})
        classes = class_probabilities(splats).argmax(dim=1)
        largest = int(torch.bincount(classes)[1:].argmax()) + 1
        share = float((classes == largest).float().mean())
        copies = max(1, round(self.gaussians * share / OBJECT))
        one = resized(splats, self.gaussians // copies)
        own = class_probabilities(one).argmax(dim=1) == largest
        width, depth = 1.02 * float(extent.size[0]), 1.02 * float(extent.size[2])
        aside = math.ceil(math.sqrt(copies))
        places = [(n % aside * width, 0.0, n // aside * depth) for n in range(copies)]
        many = one[torch.arange(len(one)).repeat(copies)]
        many.means.view(copies, -1, 3).add_(torch.tensor(places)[:, None])
        labels = (torch.arange(1, copies + 1)[:, None] * own).flatten()
        box = extent_of(one, own)
        facts = {"gaussians": len(many), "object": int(own.sum()), "copies": copies}
        facts |= {"box": [*box.low.tolist(), *box.high.tolist()], "point": shown(many, labels)}
        self.write(folder, many, labels, facts)

    def write(self, folder: Path, splats: "Splats", labels: "Tensor", facts: dict) -> None:
        """Write all that commands are given."""
        import numpy as np
        import torch

        from stylesplat.demo.demo_capture import STYLES
        from stylesplat.io.images import write_image
        from stylesplat.io.splats.splat_files import write_splats

        write_splats(splats, folder / "grid.ply")
        np.save(folder / "labels.npy", labels.numpy().astype(np.int32))
        for name, draw in STYLES.items():
            write_image(torch.from_numpy(draw()), folder / f"{name}.png")
        (folder / "facts.json").write_text(json.dumps(facts))


def shown(splats: "Splats", labels: "Tensor") -> str:
    """A pixel amid an object, in that view of four that `import` gives it which shows most."""
    import torch

    from stylesplat.rendering.shares import coverage
    from stylesplat.scene.framing import ring_cameras

    def best(camera: "Cameras") -> tuple[float, str]:
        seen = coverage(splats, camera, labels > 0)
        means = torch.nn.functional.avg_pool2d(seen[None], 9, 1, padding=4)[0]
        y, x = divmod(int(means.argmax()), camera.size[0])
        return float(means.max()), f"{camera.names[0]}:{x},{y}"

    cameras = ring_cameras(splats, torch.tensor([0.0, -1.0, 0.0]))
    return max(best(cameras[index]) for index in VIEWS)[1]


def pieces(splats: "Splats", count: int) -> "Tensor":
    """A label for each Gaussian: which of some of them, drawn at random, it is nearest to."""
    import torch
    from scipy.spatial import KDTree

    generator = torch.Generator().manual_seed(0)
    middles = splats.means[torch.randperm(len(splats), generator=generator)[:count]]
    _, nearest = KDTree(middles.double().numpy()).query(splats.means.double().numpy(), workers=-1)
    return 1 + torch.from_numpy(nearest)


def most_solid(splats: "Splats", labels: "Tensor") -> list[int]:
    """The objects that make up most of most pixels in those views, in order: no haze."""
    import torch

    from stylesplat.rendering.linear import contributions
    from stylesplat.rendering.shares import COVERED
    from stylesplat.scene.framing import ring_cameras

    shown, everyone = torch.zeros(int(labels.max()) + 1), torch.ones(len(splats)).bool()
    pixels = torch.zeros_like(shown)
    cameras = ring_cameras(splats, torch.tensor([0.0, -1.0, 0.0]))
    for index in VIEWS:
        view = contributions(splats, cameras[index], everyone)
        own = labels[view.gaussians]
        shown.zero_().index_add_(0, own, view.weights())
        for some in shown.argsort(descending=True)[:CANDIDATES].split(3):
            columns = torch.nn.functional.pad(some, (0, 3 - len(some)))  # as colours are three
            share = view.image((own[:, None] == columns).float())[..., : len(some)]
            pixels[some] += (share > COVERED).sum(dim=(0, 1))
    return pixels.argsort(descending=True)[: max(PAINTED)].tolist()


def measured(command: list[str], log: Path) -> dict[str, float]:
    """Run a process; its seconds, those of all its threads together, and most resident memory."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(HERE.parent / "src"), str(HERE)]),
    }
    with log.open("wb") as errors:
        start = time.monotonic()
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=errors
        )
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.monotonic() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} failed:\n{log.read_text()[-2000:]}")
    computed = used.ru_utime + used.ru_stime
    return {"seconds": seconds, "computed": computed, "memory": used.ru_maxrss * 1024}


def told(name: str, found: dict[str, float]) -> None:
    """Print a row."""
    seconds = f"{found['seconds']:.1f} s | {found['computed']:.1f} s"
    print(f"| {name} | {seconds} | {found['memory'] / GIB:.2f} GiB |", flush=True)


class Commands:
    """The commands of one folder."""

    def __init__(self, folder: Path, only: set[str]) -> None:
        self.folder, self.only = folder, only

    def run(self, name: str, verb: str, *words: object) -> dict[str, float] | None:
        """Run a command and print its row, if it is wanted."""
        if self.only and verb not in self.only:
            return None
        command = [sys.executable, "-m", "stylesplat", verb, *map(str, words)]
        found = measured(command, self.folder / f"{name.replace(' ', '_')}.log")
        told(name, found)
        return found


def style(folder: Path, number: int) -> Path:
    """One of the demo's style pictures."""
    found = sorted(folder.glob("*.png"))
    return found[number % len(found)]


def large(commands: Commands) -> None:
    """Every command that needs no training, on one object of a large splat."""
    folder = commands.folder
    scene, styled = folder / "scene", folder / "styled"
    facts = json.loads((folder / "facts.json").read_text())
    box = facts["box"]
    corners = ",".join(f"{number:.4g}" for number in box)
    centre = [(low + high) / 2 for low, high in zip(box[:3], box[3:], strict=True)]
    ball = ",".join(f"{number:.4g}" for number in [*centre, (box[3] - box[0]) / 3])
    replaced = ("-o", styled, "--overwrite")
    run = commands.run
    run(
        "import",
        "import",
        folder / "grid.ply",
        "--labels",
        folder / "labels.npy",
        "-o",
        scene,
        "--overwrite",
    )
    run("objects", "objects", scene)
    run(
        "select point",
        "select",
        scene,
        "--name",
        "clicked",
        "--point",
        facts["point"],
        "--no-picture",
    )
    run("select box", "select", scene, "--name", "boxed", f"--box3d={corners}", "--no-picture")
    run("select sphere", "select", scene, "--name", "round", f"--sphere={ball}", "--no-picture")
    run("select id", "select", scene, "--name", "one", "--id", 1, "--no-picture")
    run("select id, picture", "select", scene, "--name", "one", "--id", 1)
    run("stylize", "stylize", scene, "--style", f"one={style(folder, 0)}", *replaced)
    run("adjust", "adjust", styled, "--intensity", 0.7)
    views = [word for number in VIEWS for word in ("--view", f"view_{number:03d}.png")]
    run("render 4 views", "render", styled, "-o", folder / "views", *views, "--overwrite")
    run("export", "export", styled, folder / "painted.ply", "--overwrite")


def labelled(commands: Commands) -> None:
    """Listing, selecting and painting, among very many objects."""
    folder = commands.folder
    scene = folder / "scene"
    files = (folder / "grid.ply", "--labels", folder / "labels.npy")
    commands.run("import", "import", *files, "-o", scene, "--overwrite")
    commands.run("objects", "objects", scene)
    commands.run("select id", "select", scene, "--name", "one", "--id", 1, "--no-picture")
    ids = json.loads((folder / "facts.json").read_text())["seen"]
    for count in PAINTED:
        pictures = [f"{id}={style(folder, id)}" for id in ids[:count]]
        words = [word for picture in pictures for word in ("--style", picture)]
        options = ("--quality", "draft", "-o", folder / "styled", "--overwrite")
        commands.run(f"stylize {count}", "stylize", scene, *words, *options)


def main() -> None:
    """Make the splat, run the commands, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--gaussians", type=int, default=10_000_000)
    parser.add_argument("--labels", type=int, default=0, help="objects; 0 makes a few large ones")
    parser.add_argument("-o", "--output", type=Path, default=HERE / "out" / "large")
    parser.add_argument("--only", default="", help="verbs, separated by commas")
    parser.add_argument("--make", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    grid = Grid(options.scene, options.gaussians, options.labels)
    if options.make:
        return grid.make(options.output)
    options.output.mkdir(parents=True, exist_ok=True)
    if not (options.output / "facts.json").exists():
        # in a process of its own, so that this one stays small: children begin as large as it is
        measured([sys.executable, __file__, *sys.argv[1:], "--make"], options.output / "make.log")
    print((options.output / "facts.json").read_text(), flush=True)
    print("| command | time | of the cores | memory |\n| --- | --- | --- | --- |", flush=True)
    told("starting Python", measured([sys.executable, "-c", STARTED], options.output / "start.log"))
    commands = Commands(options.output, {*options.only.split(",")} - {""})
    return labelled(commands) if options.labels else large(commands)


if __name__ == "__main__":
    main()
