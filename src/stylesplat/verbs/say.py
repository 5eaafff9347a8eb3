"""Words for the user go to stderr: stdout is for JSON."""

import sys


def say(line: str) -> None:
    """Print one line for the user."""
    print(line, file=sys.stderr)
