"""Values of results as a person writes them: no brackets, no None, few digits."""

from collections.abc import Mapping
from typing import Any


def said(value: Any) -> str:
    """One value in words and numbers.

    Example:
        >>> print(said(["a.jpg", (1.0, 2.5)]), said(None), said(True), said(()))
        a.jpg 1, 2.5 none yes none
    """
    if value is None or value in ((), [], {}):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {said(each)}" for key, each in value.items())
    if isinstance(value, list | tuple):
        nested = any(isinstance(each, list | tuple) for each in value)
        return (" " if nested else ", ").join(said(each) for each in value if each != "")
    return str(value)
