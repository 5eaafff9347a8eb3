"""What is printed for people of what a command has done: words, or all numbers."""

from collections.abc import Iterable
from typing import Any, Protocol, runtime_checkable

from stylesplat.cli.values import said


@runtime_checkable
class Spoken(Protocol):
    """A command that has words for what it did."""

    verbose: bool
    """Whether the numbers are wanted as well."""

    def words(self, result: dict[str, Any]) -> Iterable[str]:
        """What was made, and how to go on, in lines."""
        ...


def told(command: object, result: dict[Any, Any]) -> list[str]:
    """The lines that are printed of a result, where no JSON is asked for."""
    if not isinstance(command, Spoken):
        return _numbers(result)
    words = list(command.words(result))
    return words + _numbers(result) if command.verbose else words


def _numbers(result: dict[Any, Any], indent: str = "") -> list[str]:
    """A result as text, one value a line."""
    lines = []
    for name, value in result.items():
        if isinstance(value, dict) and value:
            lines += [f"{indent}{name}:", *_numbers(value, indent + "  ")]
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            rows = (said({k: v for k, v in row.items() if v != []}) for row in value)
            lines += [f"{indent}{name}:", *(f"{indent}  {row}" for row in rows)]
        else:
            lines.append(f"{indent}{name}: {said(value)}")
    return lines
