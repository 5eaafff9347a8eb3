"""What the command line says."""

import sys


def write_lines(*lines: str) -> None:
    """Write lines to stderr in one piece: Ctrl-C leaves none of them half."""
    print("".join(f"{line}\n" for line in lines), end="", file=sys.stderr, flush=True)
