"""docs/architecture.md names rooms, files and functions that there are, in the order of imports."""

import ast
import re

import pytest

from test_layers import ORDER, ROOT

PAGE = (ROOT.parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")
PICTURE = [re.split(r"\s{3,}", line)[0].split() for line in PAGE.split("```")[1].splitlines()]
TEXT = "".join(PAGE.split("```")[::2])
NAMED = sorted({word for words in re.findall(r"`([^`]+)`", TEXT) for word in words.split()})
PLACES = {path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py")}


def test_the_picture_shows_every_room_above_those_that_it_imports():
    shown = [name for line in PICTURE for name in line]
    assert sorted(shown) == sorted(name for name in ORDER if name != "__main__")
    depth = {name: number for number, line in enumerate(PICTURE) for name in line}
    places = [depth[name] for name in ORDER if name != "__main__"]
    assert places == sorted(places, reverse=True)


@pytest.mark.parametrize("name", [word for word in NAMED if word.endswith(".py")])
def test_files_that_are_named_are_there(name: str):
    ends = any(place == name or place.endswith(f"/{name}") for place in PLACES)
    assert ends or (ROOT.parents[1] / name).is_file()


@pytest.mark.parametrize("name", [n for n in NAMED if re.fullmatch(r"\w+(/\w+)+\.\w+", n)])
def test_functions_that_are_named_are_there(name: str):
    file, _, function = name.rpartition(".")
    if function != "py":
        body = ast.parse((ROOT / f"{file}.py").read_text()).body
        assert function in [getattr(node, "name", None) for node in body]


def test_functions_over_tensors_are_those_that_the_page_on_python_names():
    page = (ROOT.parents[1] / "docs" / "python.md").read_text(encoding="utf-8")
    table = page[page.index("stylesplat.functional") :].split("\n\n")[1]
    named = {
        name for row in table.splitlines() for name in re.findall(r"`(\w+)", row.split("|")[1])
    }
    body = ast.parse((ROOT / "functional.py").read_text()).body
    assert named == {
        each.name for node in body if isinstance(node, ast.ImportFrom) for each in node.names
    }
