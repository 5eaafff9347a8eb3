"""No test is for a GPU alone: `cuda` marks parameters of tests that run on any machine as well."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import TypeGuard

import pytest

TESTS = Path(__file__).parent


def is_mark(node: ast.AST) -> TypeGuard[ast.Attribute]:
    return isinstance(node, ast.Attribute) and ast.unparse(node) == "pytest.mark.cuda"


def is_marked(node: ast.AST) -> bool:
    """Whether it is a parameter for a GPU."""
    return isinstance(node, ast.Call) and any(
        keyword.arg == "marks" and any(map(is_mark, ast.walk(keyword.value)))
        for keyword in node.keywords
    )


def misplaced(source: str) -> Iterator[int]:
    """The lines of marks that are not one parameter among others."""
    tree = ast.parse(source)
    good = {
        id(node)
        for several in ast.walk(tree)
        if isinstance(several, ast.List) and not all(map(is_marked, several.elts))
        for each in several.elts
        if is_marked(each)
        for node in ast.walk(each)
    }
    yield from (node.lineno for node in ast.walk(tree) if is_mark(node) and id(node) not in good)


def test_every_mark_is_one_parameter_among_others():
    sources = {path: path.read_text(encoding="utf-8") for path in TESTS.rglob("*.py")}
    marked = {path: source for path, source in sources.items() if "mark.cuda" in source}
    assert len(marked) >= 3
    found = {path.name: [*misplaced(source)] for path, source in marked.items()}
    assert not {name: lines for name, lines in found.items() if lines}


@pytest.mark.parametrize(
    "source",
    [
        "pytestmark = pytest.mark.cuda",
        "@pytest.mark.cuda\ndef test(): ...",
        "some = [pytest.param('cuda', marks=pytest.mark.cuda)]",
        "some = ['cpu']\nmore = [pytest.param('cuda', marks=[pytest.mark.cuda])]",
    ],
)
def test_a_test_for_a_gpu_alone_is_found(source: str):
    assert [*misplaced(source)]
    assert not [*misplaced("some = ['cpu', pytest.param('cuda', marks=pytest.mark.cuda)]")]
