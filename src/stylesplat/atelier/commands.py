"""What the command line would be told to come to the same result."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

from stylesplat.atelier.studio_state import State
from stylesplat.scene.paintings import Painting
from stylesplat.scene.pasted import pasted
from stylesplat.stylization.plain_settings import plain
from stylesplat.stylization.style_config import StyleConfig

# Of the settings, those that are no options of `stylize`
NO_OPTIONS = frozenset({"intensity", "lr", "final_lr", "view_share", "object_size"})


def commands(state: State, folder: Path, output: Path) -> list[str]:
    """The commands that give this very scene, a line each.

    Args:
        state: Of the studio.
        folder: Of the scene that was opened.
        output: Of the styled scene.
    """
    lines = [_placed(words, folder) for words in state.commands]
    scene = state.scene
    if scene.painted is None:
        return lines
    before = folder
    for number, painting in enumerate(scene.painted.paintings):
        last = number == len(scene.painted.paintings) - 1
        after = output if last else output.with_name(f"{output.name}-{number + 1}")
        lines.append(pasted("stylize", before, *_options(painting), "-o", after))
        before = after
    return lines


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
