"""Every command line of the pages: read by the real parser, and those that take seconds are run.

Painting, training, `sfm` and masks with a model take minutes, and need photos: these are parsed
alone. Other programs are not run: they change the environment, or need a network or a cluster.
"""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from doc_pages import PAGES, ROOT, blocks
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
INLINE = re.compile(r"`(stylesplat [a-z][^`\n]*)`")
PLACEHOLDERS = {"...": "x", "VERB": "objects", "HOST": "host"}


class Command(NamedTuple):
    place: str
    words: list[str]


def commands() -> Iterator[Command]:
    """Of blocks, and those in the text that have more than the name of a verb."""
    for block in blocks("sh", ""):
        text = block.text.replace("\\\n", " ")
        for number, line in enumerate(text.splitlines()):
            line = line.removeprefix("$ ")
            if block.language or line.startswith("stylesplat "):  # others show files and output
                yield from _split(f"{block.page}:{block.line + number}", line)
    for path in PAGES:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            for match in INLINE.finditer(line):
                if len(match[1].split()) > 3 and "VERB" not in match[1]:
                    yield from _split(f"{path.relative_to(ROOT).as_posix()}:{number}", match[1])


def _split(place: str, line: str) -> Iterator[Command]:
    words = shlex.split(line, comments=True)
    while words:
        end = next((i for i, word in enumerate(words) if word in ("&&", ";")), len(words))
        if words[:end]:
            yield Command(place, words[:end])
        words = words[end + 1 :]


ALL = [*commands()]
# What writes a file for the shell is run by tests/cli/test_usage.py
OURS = [
    each
    for each in ALL
    if each.words[0] == "stylesplat" and each.words[1] != "--tyro-write-completion"
]
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
