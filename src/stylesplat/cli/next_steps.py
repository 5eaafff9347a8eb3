"""Lines at the end of a verb: results, and the next commands, which can be pasted."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stylesplat.scene.arguments import pasted

PICTURE = "PICTURE.jpg"  # stands for any picture of the user's
LATER = "      "  # in front of the second command, below the first


def unused(near: Path, ending: str) -> Path:
    """A path beside a file or folder, such as `garden-scene`, that does not exist."""
    stem, dot, suffix = ending.partition(".")
    folder = near if near.name else near.resolve()  # `.` and `..` have no name of their own
    place, number = folder.with_name(f"{folder.name}{ending}"), 2
    while place.exists():
        place = folder.with_name(f"{folder.name}{stem}-{number}{dot}{suffix}")
        number += 1
    return place


def next_lines(*commands: str) -> list[str]:
    """The commands, one a line."""
    return [f"{LATER if number else 'Next: '}{command}" for number, command in enumerate(commands)]


def file_size(file: Path) -> str:
    """The size of a file."""
    return f"{file.stat().st_size / 1e6:.1f} MB"


def stylize_command(scene: Path, name: str) -> str:
    style = f"{name}={PICTURE}"
    return pasted("stylize", scene, "--style", style, "-o", unused(scene, "-painted"))


def painted_commands(scene: Path) -> list[str]:
    """Commands for a painted scene."""
    return [
        pasted("adjust", scene, "--intensity", 0.7, "-o", unused(scene, "-softer")),
        pasted("export", scene, unused(scene, ".ply")),
    ]


def mask_command(capture: Path) -> str:
    return pasted("mask", capture, "--box", "NAME=PHOTO:x0,y0,x1,y1")


def look_lines(result: dict[str, Any]) -> list[str]:
    """The picture and the names of a new scene."""
    lines = [f"Picture: {result['picture']}"] if result["picture"] else []
    return lines + [f"Objects: {', '.join(result['objects'])}."] * bool(result["objects"])


def object_commands(
    scene: Path, names: Sequence[str], *, labelled: bool, photos: bool = True
) -> list[str]:
    """The way to an object to paint, which has a name, a label id, or neither.

    Of a scene that was not made from photos, the views can be masked.
    """
    if names:
        return [stylize_command(scene, names[0])]
    if labelled:
        return [pasted("objects", scene), pasted("select", scene, "--name", "NAME", "--id", "ID")]
    by_place = pasted("select", scene, "--name", "NAME", "--sphere", "VIEW:x,y,RADIUS")
    by_box = pasted("mask", scene, "--box", "NAME=VIEW:x0,y0,x1,y1")
    look = pasted("render", scene, "-o", unused(scene, "-views"))
    return [look, by_place if photos else by_box]
