"""From the dataclass of a command to its options, by tyro, and values that are written as text.

The fields of a command are its options, and the strings under them their help. Settings of a stage
are declared in the stage's config only: a command takes them by `from_config`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import reduce
from importlib.metadata import version
from inspect import getdoc
from operator import or_
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, TypedDict, get_args, get_type_hints, is_typeddict

import tyro
from docstring_parser import parse_from_object
from tyro.conf import (
    DisallowNone,
    FlagCreatePairsOff,
    OmitArgPrefixes,
    PositionalMetavarFromFieldName,
    UseAppendAction,
    arg,
    subcommand,
)
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import is_file
from stylesplat.options import options_of, with_settings

PROGRAM = "stylesplat"
ALIASES = {"stylize": ("stylise",)}
REGISTRY = ConstructorRegistry()
CONFIGS = dict[Any, type]()  # by the settings that `from_config` made of them
TYRO = {
    "config": (DisallowNone, FlagCreatePairsOff, PositionalMetavarFromFieldName),
    "registry": REGISTRY,
}
OVERVIEW = """\
Repaint chosen objects of a 3D Gaussian splat in the style of any picture.

From photos to a painted splat:

  stylesplat mask MyPhotos --box vase=1.jpg:500,300,800,700  where the vase is
  stylesplat train MyPhotos -o scene                         photos to a splat
  stylesplat stylize scene --style vase=wave.jpg -o painted  the vase in a style
  stylesplat view painted                                    look at it
  stylesplat export painted painted.ply                      for other programs

`stylesplat VERB --help` explains a verb.
"""


def read_arguments(verbs: Mapping[str, type], arguments: Sequence[str]) -> Any:
    """The command that the user typed; exits after help, version or completion, or wrong usage."""
    name = arguments[0] if arguments else "--help"
    if name == "--version":
        print(PROGRAM, version(PROGRAM))
        raise SystemExit
    verb = next((each for each in verbs if name in (each, *ALIASES.get(each, ()))), None)
    if verb is not None:  # alone, its help begins with all that its docstring says
        return read_command(verbs[verb], arguments[1:], f"{PROGRAM} {verb}")
    commands = []
    for each, command in verbs.items():
        summary = (getdoc(command) or "").partition("\n")[0]
        named = subcommand(each, description=summary, aliases=ALIASES.get(each))
        commands.append(Annotated[command, named])
    words = arguments or ["--help"]
    return read_command(reduce(or_, commands), words, PROGRAM, description=OVERVIEW)


def read_command(kind: Any, words: Sequence[str], prog: str, **options: Any) -> Any:
    """A command, or one of a union of commands, with the options in the words after `prog`."""
    command = tyro.cli(kind, prog=prog, args=words, **TYRO, **options)
    for name, declared in settings_of(type(command)).items():
        with_settings(CONFIGS[declared](), getattr(command, name))
    return command


def settings_of(command: type) -> dict[str, type]:
    """What `from_config` made for fields of a command, by their names."""
    hints = get_type_hints(command, include_extras=True) if is_dataclass(command) else {}
    found = {name: next(filter(is_typeddict, get_args(hint)), None) for name, hint in hints.items()}
    return {name: each for name, each in found.items() if each is not None}


def help_texts(config: type) -> dict[str, str]:
    """The first paragraphs of the strings under the fields of a dataclass."""
    texts = {each.arg_name: each.description or "" for each in parse_from_object(config).params}
    return {name: " ".join(text.partition("\n\n")[0].split()) for name, text in texts.items()}


def from_config(config: type, *names: str) -> Any:
    """Annotates a dict as settings of a config, with these names or all but those for research."""
    texts, offered = help_texts(config), {}
    for field, option in options_of(config).items():
        if field not in names and (names or option.research):
            continue
        kind, *others = get_args(option.kind) or (option.kind,)
        kind = kind if others == [NoneType] else option.kind  # T of `T | None`
        offered[field] = Annotated[
            UseAppendAction[kind] if others == [...] else kind,  # lists grow as it is repeated
            arg(
                name=option.name or field,
                aliases=[f"--{field}"] if option.name else [],
                help=texts[field],
                help_behavior_hint=_hint(option.default),
            ),
        ]
    settings = TypedDict(config.__name__, offered, total=False)  # pyright: ignore
    CONFIGS[settings] = config
    return settings


def _hint(default: Any) -> str:
    """What help says of a default: nothing if that is obvious."""
    return "" if default in (None, ()) or isinstance(default, bool) else f"(default: {default})"


@REGISTRY.struct_rule
def _command(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Read a dataclass as tyro does, but join the lines of help, hide defaults such as None, and
    put the options that all verbs share last.
    """
    if not is_dataclass(info.type) or info.type.__module__.startswith("tyro"):
        return None
    kinds, texts = get_type_hints(info.type, include_extras=True), help_texts(info.type)
    options = []
    for each in sorted(fields(info.type), key=lambda each: bool(each.kw_only)):
        kind: Any = kinds[each.name]
        default = tyro.MISSING_NONPROP if each.default is MISSING else each.default
        if default is not tyro.MISSING_NONPROP and not _hint(default):
            kind = Annotated[kind, arg(help_behavior_hint="")]
        settings = next(filter(is_typeddict, get_args(kind)), None)
        if settings is not None:
            kinds_inside = get_type_hints(settings).items()
            default = {name: False for name, each in kinds_inside if each is bool}
            default |= {name: () for name, each in kinds_inside if get_args(each)[1:] == (...,)}
            kind = OmitArgPrefixes[settings]
        options.append(StructFieldSpec(each.name, kind, default, texts.get(each.name)))
    return StructConstructorSpec(info.type, tuple(options))


def parse_style(text: str) -> tuple[str, tuple[Path, ...]]:
    """An object and its style pictures. A comma belongs to a name if there is such a file.

    Example:
        >>> name, images = parse_style("vase=wave.jpg,night.jpg")
        >>> print(name, *images)
        vase wave.jpg night.jpg
    """
    name, _, images = text.partition("=")
    parts = [images] if is_file(images) else images.split(",")
    if not (name and all(parts)):
        raise StyleSplatError(
            f"Expected OBJECT=IMAGE or OBJECT=IMAGE,IMAGE, got {text!r}. "
            "OBJECT is a name that `select` gave, or an id."
        )
    return name, tuple(map(Path, parts))
