"""The command line: parse, call one verb, print."""

import json
import os
import sys
from collections.abc import Sequence
from typing import Any

import tyro

from stylesplat.cli import looking, making, mask, selecting, styling
from stylesplat.cli.bars import Bars
from stylesplat.errors import StyleSplatError
from stylesplat.progress import observed

INTERRUPTED = 130  # what shells report after Ctrl-C

VERBS = {
    "demo": making.Demo,
    "mask": mask.Mask,
    "train": making.Train,
    "import": making.Import,
    "objects": looking.Objects,
    "select": selecting.Select,
    "stylize": styling.Stylize,
    "adjust": styling.Adjust,
    "sheet": styling.Sheet,
    "render": looking.Render,
    "export": looking.Export,
    "evaluate": looking.Evaluate,
    "view": looking.View,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Returns:
        0 if it is done, 1 if the user's input is at fault (one line on stderr says what), 130
        after Ctrl-C. Wrong usage exits with 2.
    """
    command = tyro.extras.subcommand_cli_from_dict(
        VERBS,
        prog="stylesplat",
        description="Repaint chosen objects of a 3D Gaussian splat in the style of any picture.",
        args=arguments,
    )
    from stylesplat.rendering.kernels.compiling import announce_compilation  # loads numba

    announce_compilation()
    try:
        with observed(Bars()):
            result = command.run()
    except StyleSplatError as error:
        print(f"stylesplat: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stylesplat: interrupted. `train` and `mask` go on when run again.", file=sys.stderr)
        return INTERRUPTED
    if command.json:
        print(json.dumps(result, default=os.fspath))
    else:
        print(*_lines(result), sep="\n", file=sys.stderr)
    return 0


def _lines(result: dict[Any, Any], indent: str = "") -> list[str]:
    """A result as text, one value a line."""
    lines = []
    for name, value in result.items():
        if isinstance(value, dict):
            lines += [f"{indent}{name}:", *_lines(value, indent + "  ")]
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            rows = (", ".join(f"{k} {v}" for k, v in row.items() if v != []) for row in value)
            lines += [f"{indent}{name}:", *(f"{indent}  {row}" for row in rows)]
        else:
            shown = f"{value:.4g}" if isinstance(value, float) else value
            lines.append(f"{indent}{name}: {shown}")
    return lines
