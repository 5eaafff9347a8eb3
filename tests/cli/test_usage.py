"""What the command line says of itself, and what it loads before it knows what is asked for."""

import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import stylesplat as ss
from processes import complaint
from stylesplat.cli import VERBS, main

README = Path(__file__).parents[2] / "README.md"


def test_alone_it_shows_the_way_and_the_verbs(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as stopped:
        main([])
    assert not stopped.value.code
    out = capsys.readouterr().out
    way = [line.split()[1] for line in out.splitlines() if line.startswith("  stylesplat ")]
    assert way == ["mask", "train", "stylize", "view", "export"]
    assert re.findall(r"• ([a-z]+)", out) == [*VERBS]


def test_version(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])
    assert not stopped.value.code
    assert capsys.readouterr().out == f"stylesplat {version('stylesplat')}\n"


def test_both_spellings(scene: Path, capsys):
    assert "--recipe" in complaint(capsys, "stylise", scene, "-o", scene.parent / "x")
    assert ss.stylise is ss.stylize


def test_bash_completes(tmp_path: Path):
    script = tmp_path / "completion.bash"
    with pytest.raises(SystemExit):
        main(["--tyro-write-completion", "bash", str(script)])
    lines = (
        f"source {script}",
        "COMP_WORDS=(stylesplat stylize garden --color '') COMP_CWORD=4",
        "$(complete -p stylesplat | sed 's/.*-F \\([^ ]*\\).*/\\1/') stylesplat '' --color",
        'echo "${COMPREPLY[@]}"',
    )
    bash = ["bash", "--norc", "-c", "\n".join(lines)]
    done = subprocess.run(bash, capture_output=True, text=True, check=True)
    assert {*done.stdout.split()} == {"style", "keep", "blend", "free"}, done.stderr


def test_the_readme_counts_the_verbs():
    text = README.read_text(encoding="utf-8")
    assert f"{len(VERBS)} verbs" in text
    missing = [verb for verb in VERBS if f"stylesplat {verb}" not in text]
    assert not missing


PARSE = """
import contextlib, sys
from stylesplat.cli import main
with contextlib.suppress(SystemExit):
    main({arguments!r})
heavy = {{"torch", "numba", "cv2", "torchvision", "starlette"}}
print(*sorted(heavy & sys.modules.keys()))
"""


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("stylize --help", []),
        # Neither kernels nor what only detectors need
        ("select {scene} --name red --id 3 --no-picture", ["torch"]),
    ],
)
def test_slow_modules_are_loaded_when_they_are_needed(arguments: str, expected: list, scene: Path):
    script = PARSE.format(arguments=arguments.format(scene=scene).split())
    environment = {**os.environ, "PYTHONPATH": str(Path(ss.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].split() == expected
