"""Do other people's programs take our GLB for what it is, and do we take theirs?

    npm install --prefix NPM gltf-validator @playcanvas/splat-transform playcanvas
    .venv/bin/python benchmarks/gltf_check.py NPM

Three things, each of random Gaussians of every degree:

- Khronos' glTF-Validator finds no fault with a GLB of ours, nor with the same as `.gltf`. As of
  2.0.0-dev.3.10 it does not know the names that extensions give to attributes, so it calls each
  `KHR_gaussian_splatting:...` an invalid name, in the files of all programs; these lines are
  counted apart.
- PlayCanvas's engine, which SuperSplat is built on, reads from it what the splats are.
- What splat-transform makes of our PLY is read as that PLY.

splat-transform 3.7 writes GLB and reads none. The engine's own coordinates are turned by the node,
so it is its unturned numbers that are compared.
"""

import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro
from bench import table
from tyro.conf import Positional

from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.scene.splats import Splats

COUNT = 500
UNKNOWN = "MESH_PRIMITIVE_INVALID_ATTRIBUTE"
OWN = "/attributes/KHR_gaussian_splatting:"
TOLERANCE = 1e-6  # of float32 after exp and log; opacities are compared as shares
VALIDATE = """
import fs from 'fs';
import validator from 'gltf-validator';
const content = new Uint8Array(fs.readFileSync(process.argv[1]));
const report = await validator.validateBytes(content, { maxIssues: 0 });
console.log(JSON.stringify(report.issues.messages));
"""
# The engine's own reader of the extension, without a browser; it sorts the Gaussians in space
READ = """
import fs from 'fs';
import * as pc from 'playcanvas';
import path from 'path';
import { pathToFileURL } from 'url';
const parser = 'framework/parsers/glb/extensions/khr-gaussian-splatting.js';
const place = path.resolve('node_modules/playcanvas/build/playcanvas/src', parser);
const { khrGaussianSplatting } = await import(pathToFileURL(place));
const canvas = { width: 4, height: 4, style: {}, addEventListener() {} };
const content = fs.readFileSync(process.argv[1]);
const size = content.readUInt32LE(12);
const gltf = JSON.parse(content.subarray(20, 20 + size));
const views = gltf.bufferViews.map(({ byteOffset, byteLength }) =>
    new Uint8Array(content.subarray(28 + size + byteOffset).subarray(0, byteLength)));
const device = new pc.NullGraphicsDevice(canvas);
const [[{ gsplatData }]] = khrGaussianSplatting.createResources(device, gltf, views);
const { properties } = gsplatData.elements[0];
const columns = properties.map(({ name, storage }) => [name, [...storage]]);
console.log(JSON.stringify(Object.fromEntries(columns)));
"""


@dataclass(frozen=True)
class Options:
    """Where the programs are."""

    npm: Positional[Path]
    """Folder in which npm has installed gltf-validator, @playcanvas/splat-transform, playcanvas."""


def some(degree: int) -> Splats:
    """Gaussians with rotations of norm 1, and colours of a degree."""
    generator = torch.Generator().manual_seed(degree)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    quats = torch.nn.functional.normalize(normal(COUNT, 4), dim=1)
    bands = (degree + 1) ** 2 - 1
    return Splats(
        means=5 * normal(COUNT, 3),
        quats=quats,
        scales=normal(COUNT, 3) - 4,
        opacities=3 * normal(COUNT),
        sh0=normal(COUNT, 1, 3),
        shN=0.3 * normal(COUNT, bands, 3),
    )


def node(npm: Path, *arguments: str | Path) -> str:
    """What a JavaScript program prints."""
    done = subprocess.run(
        ["node", *map(str, arguments)], cwd=npm, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise StyleSplatError(f"node failed: {done.stderr.strip()[-300:]}. Are the packages there?")
    return done.stdout


def run(npm: Path, script: str, file: Path) -> Any:
    """The JSON that a script prints of a file."""
    return json.loads(node(npm, "--input-type=module", "-e", script, file))


def faults(npm: Path, file: Path) -> tuple[list[str], int]:
    """The validator's errors and warnings, and how many names it does not know."""
    severe = [each for each in run(npm, VALIDATE, file) if each["severity"] <= 1]
    strange = [each for each in severe if each["code"] != UNKNOWN or OWN not in each["pointer"]]
    told = [f"{each['code']} at {each['pointer']}: {each['message']}" for each in strange]
    return told, len(severe) - len(strange)


def by_engine(npm: Path, file: Path) -> Splats:
    """What PlayCanvas's engine reads, which keeps shares and standard deviations as they are."""
    columns = {name: torch.tensor(rows) for name, rows in run(npm, READ, file).items()}
    bands = sum(name.startswith("f_rest_") for name in columns) // 3

    def take(*names: str) -> torch.Tensor:
        return torch.stack([columns[name] for name in names], dim=1)

    rest = [take(*(f"f_rest_{bands * rgb + band}" for rgb in range(3))) for band in range(bands)]
    return Splats(
        means=take("x", "y", "z"),
        quats=take(*(f"rot_{i}" for i in range(4))),
        scales=take(*(f"scale_{i}" for i in range(3))).log(),
        opacities=columns["opacity"].double().logit().float(),
        sh0=take(*(f"f_dc_{i}" for i in range(3)))[:, None],
        shN=torch.stack(rest, dim=1) if rest else torch.zeros(len(columns["x"]), 0, 3),
    )


def by_transform(npm: Path, splats: Splats, folder: Path) -> Splats:
    """What we read of the GLB that splat-transform makes of our PLY."""
    write_splats(splats, folder / "ours.ply", sh_degree=splats.sh_degree)
    program = npm / "node_modules/@playcanvas/splat-transform/bin/cli.mjs"
    node(npm, program, "-q", "-w", folder / "ours.ply", folder / "theirs.glb")
    return read_splats(folder / "theirs.glb")


def difference(found: Splats, expected: Splats) -> float:
    """The largest of any number, rows being matched by their places and rotations by their sign."""
    if len(found) != len(expected) or found.sh_degree != expected.sh_degree:
        return float("inf")
    found = found[torch.cdist(expected.means.double(), found.means.double()).argmin(dim=1)]
    signs = (found.quats * expected.quats).sum(dim=1, keepdim=True).sign()
    pairs = [
        *((getattr(found, n), getattr(expected, n)) for n in ("means", "scales", "sh0", "shN")),
        (found.opacities.sigmoid(), expected.opacities.sigmoid()),
        (found.quats * signs, expected.quats),
    ]
    return max(float((a - b).abs().max()) for a, b in pairs if a.numel())


def check(npm: Path, degree: int) -> tuple[list[object], bool]:
    """A row of the table, and whether all is well."""
    splats = some(degree)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_splats(splats, folder / "ours.glb", sh_degree=degree)
        write_splats(splats, folder / "ours.gltf", sh_degree=degree)
        told, unknown = faults(npm, folder / "ours.glb")
        told += faults(npm, folder / "ours.gltf")[0]
        engine = difference(by_engine(npm, folder / "ours.glb"), splats)
        ours = difference(read_splats(folder / "ours.glb"), splats)
        theirs = difference(by_transform(npm, splats, folder), splats)
    for line in told:
        print(line)
    row = [degree, len(told), unknown, f"{engine:.1e}", f"{theirs:.1e}", f"{ours:.1e}"]
    return row, not told and max(engine, theirs, ours) < TOLERANCE


def main(options: Options) -> int:
    """Print the table; 1 if anything is wrong."""
    npm = options.npm.resolve()
    checked = [check(npm, degree) for degree in range(4)]
    heads = ["degree", "faults", "(names unknown)", "engine", "splat-transform", "ours again"]
    print(table(heads, [row for row, _ in checked]))
    print(f"largest differences, {COUNT} Gaussians; bound {TOLERANCE:.0e}")
    return 0 if all(fine for _, fine in checked) else 1


if __name__ == "__main__":
    raise SystemExit(main(tyro.cli(Options)))
