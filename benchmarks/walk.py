"""How long a reader's walk through the code is, who follows one painting, selection or mask.

    .venv/bin/python benchmarks/walk.py [--show]

Each verb runs on a small scene of balls under `sys.setprofile`. A reader who follows it opens each
function of the package where it is called first. A *stay* is a run of functions in one file, a
*place* is a file, and a *climb* leads into a room above, as `tests/test_layers.py` orders them.
Left out is what reads by itself: functions of three lines, nouns, files, kernels, messages.
"""

import argparse
import ast
import sys
from collections.abc import Callable
from functools import cache
from itertools import groupby, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

from bench import table

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

import stylesplat as ss
from balls import BARE, LIGHT, PICKED, VIEWS, around, dense_ball, write_pictures
from stylesplat.scene.objects import SceneObject
from test_layers import ORDER, ROOT

SMALL = 3  # lines of a function that a reader takes in at the call
ASIDE = ("errors", "progress", "runtime", "torch_modes", "options", "io", "scene/splats")
ASIDE += ("scene/cameras", "rendering/kernels", "interrupts", "signals")


@cache
def bodies(file: str) -> dict[tuple[int, str], int]:
    """Lines of the body of each function of a file, by its first line and its name."""
    found = {}
    for node in ast.walk(ast.parse((ROOT / file).read_text())):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] or node.body if ast.get_docstring(node) else node.body
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            found[first, node.name] = (body[-1].end_lineno or 0) - body[0].lineno + 1
    return found


def first_visits(act: Callable[[], Any]) -> list[tuple[str, str]]:
    """File and name of the functions that a reader opens, in the order of first calls."""
    seen = dict[Any, tuple[str, str]]()

    def visit(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code not in seen and code.co_filename.startswith(f"{ROOT}/"):
            seen[code] = Path(code.co_filename).relative_to(ROOT).as_posix(), code.co_qualname

    sys.setprofile(visit)
    try:
        act()
    finally:
        sys.setprofile(None)
    return [
        (file, name)
        for code, (file, name) in seen.items()
        if not file.startswith(ASIDE) and "<" not in name
        if bodies(file).get((code.co_firstlineno, code.co_name), 0) > SMALL
    ]


def measure(visits: list[tuple[str, str]]) -> tuple[int, int, int]:
    """Stays, places and climbs of a walk."""
    stays = [file for file, _ in groupby(visits, key=lambda visit: visit[0])]
    rooms = [ORDER.index(file.split("/")[0].removesuffix(".py")) for file in stays]
    return len(stays), len(set(stays)), sum(a < b for a, b in pairwise(rooms))


def main() -> None:
    """Print the walks of three verbs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--show", action="store_true", help="name each function that is opened")
    arguments = parser.parse_args()
    scene = ss.Scene(dense_ball(LIGHT), VIEWS, objects={"ball": SceneObject(PICKED)})
    with TemporaryDirectory() as folder:
        style = ss.Style(write_pictures(Path(folder))[0], steps=12, object_size=60)
        view, (x0, y0, x1, y1) = around(7, VIEWS.names[0])
        point = view, (x0 + x1) / 2, (y0 + y1) / 2
        acts = {
            "stylize": lambda: ss.stylize(scene, {"ball": style}, device="cpu"),
            "select": lambda: ss.select(BARE, "ball", point=point),
            "mask": lambda: ss.mask(BARE, boxes={"ball": (view, x0, y0, x1, y1)}, device="cpu"),
        }
        for act in acts:  # what loads and compiles is no part of a walk
            getattr(ss, act)
        visits = {name: first_visits(act) for name, act in acts.items()}
    print(
        table(("verb", "stays", "places", "climbs"), [(n, *measure(v)) for n, v in visits.items()])
    )
    for name, walk in visits.items() if arguments.show else ():
        print("\n".join([f"\n{name}", *(f"  {file}: {function}" for file, function in walk)]))


if __name__ == "__main__":
    main()
