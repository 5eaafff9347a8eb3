"""The commands that give the scene of a studio."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path

import torch

from stylesplat.scene.arguments import pasted
from stylesplat.scene.layer import Layer
from stylesplat.studio_app.history import StudioState
from stylesplat.studio_app.picking import DRAWN
from stylesplat.stylization.config import StyleConfig, plain_settings

# Settings that are no options of `stylize`
NO_OPTIONS = frozenset({"intensity", "lr", "final_lr", "view_share", "object_size"})


def command_lines(
    state: StudioState, folder: Path, output: Path, held: StudioState | None = None
) -> list[str] | None:
    """The commands that lead to a state from the one that a folder holds, if any do."""
    known, layers = held.commands if held else (), held.scene.layers if held else ()
    new = [
        each for each in state.scene.layers if not any(_is_same(each, other) for other in layers)
    ]
    before = [layer.name for layer in layers]
    added = [layer.name for layer in new if layer.name not in before]
    objects = [layer.name for layer in state.scene.layers]
    if state.commands[: len(known)] != known or [*before, *added] != objects:
        return None
    lines = [_with_folder(words, folder) for words in state.commands[len(known) :]]
    source = folder
    for number, layer in enumerate(new):
        last = number == len(new) - 1
        after = output if last else output.with_name(f"{output.name}-{number + 1}")
        verb = "stylize" if layer.color_map is None else "recolor"
        lines.append(pasted(verb, source, *_options(layer), "-o", after))
        source = after
    return lines


def _is_same(a: Layer, b: Layer) -> bool:
    names = ("name", "styles", "settings", "strength", "form")
    return all(getattr(a, n) == getattr(b, n) for n in names) and torch.equal(a.rows, b.rows)


def _with_folder(words: tuple[str, ...], folder: Path) -> str:
    if words[0] == DRAWN:
        return " ".join(words)
    return pasted(*(str(folder) if word == "SCENE" else word for word in words))


def _options(layer: Layer) -> Iterator[str]:
    pictures = ",".join(str(source.path or "PICTURE") for source in layer.styles)
    if layer.color_map is not None:
        yield from ("--object", layer.object)
        match = {"match": pictures} if pictures else {}
        for name, value in {**layer.settings, **match, "strength": layer.strength}.items():
            if (name, value) != ("strength", 1):
                yield f"--{name}={value}"
        return
    yield from ("--style", f"{layer.object}={pictures}")
    usual = plain_settings(StyleConfig())
    for field in fields(StyleConfig):
        value = layer.settings.get(field.name, usual[field.name])
        value = layer.form if field.name == "form" else value
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


def commands_text(state: StudioState, folder: Path, held: Mapping[Path, StudioState]) -> str:
    """The commands that give a state, from a folder that holds a part of it."""
    text = list[str]()
    for start in (folder, *(other for other in held if other != folder)):
        output = start.resolve().with_name(f"{start.resolve().name}-painted")
        lines = command_lines(state, start, output, held[start])
        if lines:
            return "\n".join([*text, *map(wrap_command, lines)])
        if start == folder:
            fact = "holds all of this" if lines is not None else "holds more than this"
            text.append(f"# {folder} {fact}")
    lines = command_lines(state, folder, folder.with_name(f"{folder.name}-painted")) or []
    text += ["# and came about like this", *map(wrap_command, lines)] if lines else []
    return "\n".join(text)


def wrap_command(command: str) -> str:
    """A command over several lines, unless it has quotes."""
    return command if "'" in command else command.replace(" -", " \\\n  -")
