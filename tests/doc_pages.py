"""The pages that people read, the blocks of code in them, and their command lines."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PAGES = (
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    ROOT / "SECURITY.md",
    ROOT / "benchmarks" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
)
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """Code between fences."""

    page: str
    language: str
    text: str
    line: int

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(*languages: str) -> list[Block]:
    """Those of some languages, or all."""
    return [each for each in _blocks() if not languages or each.language in languages]


def _blocks() -> Iterator[Block]:
    for path in PAGES:
        text = path.read_text(encoding="utf-8")
        for match in FENCE.finditer(text):
            line = text.count("\n", 0, match.start()) + 2
            yield Block(path.relative_to(ROOT).as_posix(), match[1], match[2], line)


INLINE = re.compile(r"`(stylesplat [a-z][^`\n]*)`")


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
