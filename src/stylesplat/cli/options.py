"""Options that several verbs share."""

from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import FlagCreatePairsOff, arg

from stylesplat.errors import StyleSplatError

Device = Literal["auto", "cpu", "cuda"]
Output = Annotated[Path, arg(aliases=["-o"])]
OptionalOutput = Annotated[Path | None, arg(aliases=["-o"])]
Json = Annotated[FlagCreatePairsOff[bool], arg(help="Print the result as JSON on stdout.")]
Verbose = Annotated[FlagCreatePairsOff[bool], arg(help="Print the numbers as well.")]
Overwrite = Annotated[FlagCreatePairsOff[bool], arg(help="Replace what the output holds.")]
PICTURES = (".png", ".jpg", ".jpeg", ".webp")
CONTINUES = "The same command goes on where it stopped."  # said of verbs that do


def given(command: object, names: tuple[str, ...]) -> dict[str, Any]:
    """The options of a command that the user set."""
    values = {name: getattr(command, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def refuse_given(command: object, names: tuple[str, ...], why: str) -> None:
    """Refuse options that would change nothing.

    Raises:
        StyleSplatError: If one of them is set.
    """
    for name in names:
        if getattr(command, name):
            option = {"source": "from"}.get(name, name).replace("_", "-")
            raise StyleSplatError(f"--{option} means nothing with {why}. Leave it out.")


def refuse_picture(output: Path, *, overwrite: bool) -> None:
    """Refuse a place that no picture can be written to.

    Raises:
        StyleSplatError: If its name is that of no picture, or something is there.
    """
    from stylesplat.io.atomic import refuse_file

    if output.suffix.lower() not in PICTURES:
        raise StyleSplatError(f"Cannot draw into {output}: use a name in {', '.join(PICTURES)}.")
    refuse_file(output, overwrite=overwrite)
