"""What results are called: the scene, the verbs, and what varies."""

import re
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from stylesplat.batch_jobs.products import Shown

LONGEST = 120  # characters; systems take 255 bytes, and beside a result lie longer names
UNFIT = re.compile(r"[^\w.+~]+")  # what is no letter, digit, dot or underscore


def parts_of(alternatives: Sequence[Sequence[Shown]]) -> list[str]:
    """What tells the values of an option apart, as briefly as that can be.

    Args:
        alternatives: What can be said of each value; nothing is where there is only one.

    Example:
        >>> parts_of([[("vase", (Path("a/wave.jpg"),))], [("vase", (Path("a/night.jpg"),))]])
        ['vase-wave', 'vase-night']
        >>> parts_of([[("vase", (Path("a/wave.jpg"),))], [("vase", (Path("b/wave.jpg"),))]])
        ['vase-a-wave.jpg', 'vase-b-wave.jpg']
    """
    if len(alternatives) == 1:
        return [""]
    common = set(alternatives[0]).intersection(*alternatives[1:])
    differing = [[shown for shown in each if shown not in common] for each in alternatives]
    found: list[str] = []
    for exact in range(3):
        found = ["-".join(_said(shown, exact) for shown in each) for each in differing]
        if len(set(found)) == len(found):
            break
    return found


def result_name(*parts: str | None) -> str:
    """A name for a folder that holds what parts say, on all systems.

    Example:
        >>> result_name("my garden", "stylize", "", "vase-wave", "scale-2.0")
        'my-garden-stylize-vase-wave-scale-2.0'
    """
    whole = "-".join(part for part in parts if part)
    name = UNFIT.sub("-", whole).strip("-.") or "job"
    if len(name) <= LONGEST and len(name.encode()) <= 2 * LONGEST:
        return name
    return f"{name[: LONGEST // 2]}~{sha256(whole.encode()).hexdigest()[:12]}"


def _said(shown: Shown, exact: int) -> str:
    what, values = shown
    return "-".join(filter(None, [what, *(_called(each, exact) for each in values)]))


def _called(value: str | Path, exact: int) -> str:
    """A value; of a path its stem, its name, or also its folder."""
    if isinstance(value, str):
        return value
    return (value.stem, value.name, f"{value.parent.name}-{value.name}")[exact]
