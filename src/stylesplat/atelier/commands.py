"""What the command line would be told to come to the same result."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import torch

from stylesplat.atelier.studio_state import State
from stylesplat.scene.paintings import Painting
from stylesplat.scene.pasted import pasted
from stylesplat.stylization.plain_settings import plain
from stylesplat.stylization.style_config import StyleConfig

# Of the settings, those that are no options of `stylize`
NO_OPTIONS = frozenset({"intensity", "lr", "final_lr", "view_share", "object_size"})


@dataclass(frozen=True)
class Held:
    """What a folder holds."""

    commands: tuple[tuple[str, ...], ...] = ()
    """Those of its state."""
    paintings: tuple[Painting, ...] = ()
    """In their order."""


def held_by(state: State) -> Held:
    """What a folder holds that a state was written to."""
    return Held(state.commands, _paintings(state))


def commands(
    state: State, folder: Path, output: Path, held: Held | None = None
) -> list[str] | None:
    """The commands that give this very scene, a line each.

    Args:
        state: Of the studio.
        folder: Where they start.
        output: Of the styled scene.
        held: What of it the folder holds already; nothing by default.

    Returns:
        None if the folder holds something that this scene has no longer.
    """
    held = held or Held()
    known, paintings = len(held.commands), _paintings(state)
    kept = [painting for painting in paintings if _among(painting, held.paintings)]
    new = paintings[len(kept) :]
    anew = {painting.name for painting in new}
    gone = [p for p in held.paintings if not _among(p, kept) and p.name not in anew]
    if state.commands[:known] != held.commands or gone or not _alike(paintings, kept):
        return None
    lines = [_placed(words, folder) for words in state.commands[known:]]
    before = folder
    for number, painting in enumerate(new):
        last = number == len(new) - 1
        after = output if last else output.with_name(f"{output.name}-{number + 1}")
        lines.append(pasted("stylize", before, *_options(painting), "-o", after))
        before = after
    return lines


def _paintings(state: State) -> tuple[Painting, ...]:
    painted = state.scene.painted
    return () if painted is None else tuple(painted.paintings)


def _among(painting: Painting, others: Sequence[Painting]) -> bool:
    return any(_same(painting, other) for other in others)


def _alike(paintings: Sequence[Painting], begin: Sequence[Painting]) -> bool:
    return all(_same(a, b) for a, b in zip(paintings, begin, strict=False))


def _same(a: Painting, b: Painting) -> bool:
    """Whether two are one painting: of the same Gaussians, at the same strength."""
    names = ("name", "styles", "settings", "intensity")
    same = all(getattr(a, name) == getattr(b, name) for name in names)
    return same and torch.equal(a.picked[: len(b.picked)], b.picked[: len(a.picked)])


def _placed(words: tuple[str, ...], folder: Path) -> str:
    return pasted(*(str(folder) if word == "SCENE" else word for word in words))


def _options(painting: Painting) -> Iterator[str]:
    pictures = ",".join(str(source.path or "PICTURE") for source in painting.styles)
    yield from ("--style", f"{painting.name}={pictures}")
    usual = plain(StyleConfig())
    for field in fields(StyleConfig):
        value = painting.settings.get(field.name, usual[field.name])
        if field.name in NO_OPTIONS or value == usual[field.name]:
            continue
        option = f"--{field.name.replace('_', '-')}"
        if value is True:
            yield option
        elif isinstance(value, list):
            yield from (option, *map(str, value))
        else:
            yield f"{option}={value}"
    if painting.intensity != 1:
        yield f"--intensity={painting.intensity:g}"
