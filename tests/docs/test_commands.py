"""Every command line of the pages: read by the real parser, and those that take seconds are run.

Painting, training, `sfm` and masks with a model take minutes, and need photos: these are parsed
alone. Other programs are not run: they change the environment, or need a network or a cluster.
"""

import re
import shlex
from pathlib import Path

import pytest

from doc_pages import ALL, OURS, PAGES, ROOT, Command
from stylesplat.cli import VERBS
from stylesplat.cli.arguments import read_arguments

OTHERS = {  # programs that are not run, and why
    "git": "fetches the repository",
    "cd": "of the shell",
    "pip": "changes the environment",
    "python3": "makes an environment, or serves files",
    ".": "of the shell",
    "make": "installs, then runs what CI runs",
    "pre-commit": "changes the repository",
    "torchrun": "needs several GPUs",
    "ray": "needs a cluster",
    "rclone": "needs a bucket",
    "python": "a script of the repository, whose file is looked up",
    ".venv/bin/pytest": "the suite itself, whose paths are looked up",
    "apt-get": "changes the system",
}
PLACEHOLDERS = {"...": "x", "VERB": "objects", "HOST": "host"}
SCRIPT = re.compile(r"(?:scripts|benchmarks|examples|tests)/[\w/]+\.(?:py|ipynb)")


def test_pages_have_commands():
    assert len(OURS) > 150 and len({each.words[1] for each in OURS} & {*VERBS}) == len(VERBS)


def parse(words: list[str]) -> object:
    return read_arguments(VERBS, [PLACEHOLDERS.get(word, word) for word in words])


@pytest.mark.parametrize("command", OURS, ids=lambda each: f"{each.place} {each.words[1]}")
def test_the_parser_takes_it(command: Command, capsys: pytest.CaptureFixture[str]):
    try:
        assert type(parse(command.words[1:])) in VERBS.values()
    except SystemExit as stopped:  # help, the version, completion
        said = capsys.readouterr()
        assert not stopped.code, f"{shlex.join(command.words)}\n{said.err}"


def test_other_programs_are_named_with_the_reason():
    for place, words in ALL:
        if words[0] != "stylesplat" and not words[0].isidentifier():
            assert words[0] in OTHERS or "=" in words[0], f"{place}: {words[0]}"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_scripts_that_are_named_are_there(path: Path):
    named = {*SCRIPT.findall(path.read_text(encoding="utf-8"))}
    assert not [name for name in named if not (ROOT / name).is_file()]
