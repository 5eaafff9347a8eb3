"""Python of the pages: it compiles, and what it names and passes is there.

It is not run: it takes photos, scenes and minutes. The notebook and the scripts of examples/ show
the same calls and are run (tests/examples).
"""

import ast
import inspect
import json
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import pytest
import yaml

import stylesplat as ss
from doc_pages import Block, blocks

PYTHON = blocks("python")


def place(block: Block) -> str:
    return block.place


@pytest.mark.parametrize("block", PYTHON, ids=place)
def test_what_it_imports_is_there(block: Block):
    for node in ast.walk(ast.parse(block.text)):
        match node:
            case ast.Import():
                for each in node.names:
                    import_module(each.name)
            case ast.ImportFrom(module=str(module)):
                found = import_module(module)
                assert not [each.name for each in node.names if not hasattr(found, each.name)]


def calls(block: Block) -> Iterator[tuple[str, ast.Call]]:
    """Calls of what the package exports."""
    for node in ast.walk(ast.parse(block.text)):
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="ss"), attr=name)):
                yield name, node


@pytest.mark.parametrize("block", PYTHON, ids=place)
def test_its_calls_fit_the_signatures(block: Block):
    for name, call in calls(block):
        function: Any = getattr(ss, name)
        keywords = {each.arg: ... for each in call.keywords if each.arg is not None}
        positions = [... for each in call.args if not isinstance(each, ast.Starred)]
        inspect.signature(function).bind(*positions, **keywords)


@pytest.mark.parametrize("block", PYTHON, ids=place)
def test_what_it_takes_from_the_package_is_there(block: Block):
    names = {
        node.attr
        for node in ast.walk(ast.parse(block.text))
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "ss"
    }
    assert not [name for name in names if not hasattr(ss, name)]


@pytest.mark.parametrize("block", blocks("json"), ids=place)
def test_json_is_valid(block: Block):
    json.loads(block.text)


@pytest.mark.parametrize("block", blocks("yaml"), ids=place)
def test_yaml_is_valid(block: Block):
    assert isinstance(yaml.safe_load(block.text), dict)


def test_every_block_is_of_a_language_that_is_checked_or_named():
    checked = {"python", "sh", "json", "yaml"}
    others = {"js": "runs in a browser, with Cesium", "": "files, output", "bibtex": "for LaTeX"}
    assert {each.language for each in blocks()} == {*checked, *others}
