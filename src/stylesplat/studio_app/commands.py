"""What the command line would be told to come to the same result."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import torch

from stylesplat.scene.layer import Layer
from stylesplat.scene.pasted import pasted
from stylesplat.studio_app.studio_state import State
from stylesplat.stylization.config import StyleConfig, plain_settings

# Of the settings, those that are no options of `stylize`
NO_OPTIONS = frozenset({"intensity", "lr", "final_lr", "view_share", "object_size"})


@dataclass(frozen=True)
class Held:
    """What a folder holds."""

    commands: tuple[tuple[str, ...], ...] = ()
    """Those of its state."""
    layers: tuple[Layer, ...] = ()
    """The lowest first."""


def held_by(state: State) -> Held:
    """What a folder holds that a state was written to."""
    return Held(state.commands, state.scene.layers)


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
    known, layers = len(held.commands), state.scene.layers
    new = [layer for layer in layers if not any(_same(layer, other) for other in held.layers)]
    before = [layer.object for layer in held.layers]
    added = [layer.object for layer in new if layer.object not in before]
    if state.commands[:known] != held.commands or [*before, *added] != _objects(layers):
        return None
    lines = [_placed(words, folder) for words in state.commands[known:]]
    source = folder
    for number, layer in enumerate(new):
        last = number == len(new) - 1
        after = output if last else output.with_name(f"{output.name}-{number + 1}")
        lines.append(pasted("stylize", source, *_options(layer), "-o", after))
        source = after
    return lines


def _objects(layers: Sequence[Layer]) -> list[str]:
    return [layer.object for layer in layers]


def _same(a: Layer, b: Layer) -> bool:
    """Whether two are one layer: of the same Gaussians, as strong."""
    names = ("object", "styles", "settings", "strength", "form")
    return all(getattr(a, n) == getattr(b, n) for n in names) and torch.equal(a.rows, b.rows)


def _placed(words: tuple[str, ...], folder: Path) -> str:
    return pasted(*(str(folder) if word == "SCENE" else word for word in words))


def _options(layer: Layer) -> Iterator[str]:
    pictures = ",".join(str(source.path or "PICTURE") for source in layer.styles)
    yield from ("--style", f"{layer.object}={pictures}")
    usual = plain_settings(StyleConfig())
    for field in fields(StyleConfig):
        value = layer.settings.get(field.name, usual[field.name])
        if field.name in NO_OPTIONS or value == usual[field.name]:
            continue
        option = f"--{field.name.replace('_', '-')}"
        if value is True:
            yield option
        elif isinstance(value, list):
            yield from (option, *map(str, value))
        else:
            yield f"{option}={value}"
    if layer.strength != 1:
        yield f"--intensity={layer.strength:g}"
