"""The extension of Blender: BLENDER_PYTHON names a Python with `bpy`, or BLENDER Blender itself."""

import json
import os
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

import stylesplat as ss
from balls import dense_ball

EXTENSION = Path(__file__).parents[2] / "blender"
SCRIPT = Path(__file__).with_name("in_blender.py")
PYTHON = os.environ.get("BLENDER_PYTHON") or (sys.executable if find_spec("bpy") else None)
BLENDER = os.environ.get("BLENDER")
MINUTES = 60  # seconds; three paintings, two meshes and as many starts of the program
IN_BLENDER = pytest.mark.skipif(
    not (PYTHON or BLENDER), reason="BLENDER_PYTHON names no Python with bpy"
)


def test_the_manifest_says_what_blender_asks():
    manifest = tomllib.loads((EXTENSION / "blender_manifest.toml").read_text())
    needed = {"schema_version", "id", "version", "name", "tagline", "maintainer", "type", "license"}
    assert needed | {"blender_version_min"} <= {*manifest}
    assert len(manifest["tagline"]) <= 64 and not manifest["tagline"].endswith(".")
    assert all(len(text) <= 64 for text in manifest["permissions"].values())


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("blender")
    ss.export(dense_ball(torch.ones(1500, 3)), folder / "ball.ply")
    pixels = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(2))
    Image.fromarray((255 * pixels).byte().numpy()).save(folder / "wave.jpg")
    program = folder / "stylesplat"  # as pip makes it, in the environment of this test
    path = os.pathsep.join(sys.path)
    program.write_text(
        f"#!{sys.executable}\nimport sys\nsys.path[:0] = {path.split(os.pathsep)!r}\n"
        "from stylesplat.__main__ import main\nsys.exit(main())\n"
    )
    program.chmod(0o755)
    start = [BLENDER, "--background", "--factory-startup", "--python"] if BLENDER else [PYTHON]
    given = EXTENSION, folder / "ball.ply", folder / "wave.jpg", program
    command = [*map(str, start), str(SCRIPT), "--", *map(str, given)]
    clean = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(command, env=clean, capture_output=True, text=True)
    lines = [line for line in done.stdout.splitlines() if line.startswith("FACTS ")]
    assert lines, done.stderr[-3000:]
    return json.loads(lines[0].removeprefix("FACTS "))


@IN_BLENDER
@pytest.mark.timeout(20 * MINUTES)
@pytest.mark.parametrize("kind", ["vertices", "points"])
def test_selected_points_are_painted_and_the_rest_stays_to_the_bit(
    kind: str, facts: dict[str, Any]
):
    if kind not in facts:
        pytest.skip(f"Blender {facts['version']} has no splats of its own")
    found = facts[kind]
    numbers = {name: found.pop(name) for name in ("painted", "mesh_off")}
    assert all(found.values()), found
    assert numbers["painted"] > 0.5 and numbers["mesh_off"] < 0.25, numbers


@IN_BLENDER
@pytest.mark.timeout(20 * MINUTES)
def test_what_is_wrong_is_said_in_one_line(facts: dict[str, Any]):
    for name, fact in (
        ("no_picture", "no picture.jpg"),
        ("no_program", "no-such-program"),
        ("no_layer", "no layer"),
    ):
        assert fact in facts[name] and len(facts[name].splitlines()) == 1, facts[name]
