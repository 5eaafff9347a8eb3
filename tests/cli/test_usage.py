"""What the command line says of itself."""

import re
import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest

import stylesplat as ss
from processes import complaint, run
from stylesplat.cli import VERBS, main
from stylesplat.io.splats.splat_files import read_splats

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


def test_export_takes_its_file_either_way(scene: Path, tmp_path: Path, capsys):
    assert run("export", scene, tmp_path / "a.ply") == 0
    assert run("export", scene, "-o", tmp_path / "b.ply") == 0
    assert len(read_splats(tmp_path / "a.ply")) == len(read_splats(tmp_path / "b.ply"))
    assert "Name one file" in complaint(capsys, "export", scene)
    assert "Name one file" in complaint(capsys, "export", scene, "a.ply", "-o", "b.ply")


def test_the_sheet_of_objects_goes_where_it_is_told(scene: Path, tmp_path: Path, capsys):
    assert run("objects", scene, "-o", tmp_path / "sheet.png") == 0
    assert (tmp_path / "sheet.png").is_file() and not (scene / "objects.png").exists()
    assert "--overwrite" in complaint(capsys, "objects", scene, "-o", tmp_path / "sheet.png")


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
