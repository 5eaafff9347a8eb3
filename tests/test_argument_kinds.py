"""Arguments of wrong kinds: our own error, which names the call, the argument and a way on."""

import inspect
from typing import Any

import pytest

import stylesplat as ss
from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError

SCENE = ss.Scene(SPLATS, CAMERAS)
VERBS = [name for name in dir(ss) if inspect.isfunction(getattr(ss, name))]


class Wrong:
    """Of no kind that anything takes."""


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_refuses_what_it_does_not_take(name: str):
    verb = getattr(ss, name)
    needed = [
        each.name
        for each in inspect.signature(verb).parameters.values()
        if each.default is each.empty and each.kind == each.POSITIONAL_OR_KEYWORD
    ]
    with pytest.raises(StyleSplatError, match=f"{verb.__name__}.*`{needed[0]}`.*is Wrong"):
        verb(**dict.fromkeys(needed, Wrong()))


@pytest.mark.parametrize(
    ("verb", "arguments", "facts"),
    [
        (ss.stylize, (SCENE, "starry.jpg"), ("styles", "str", "starry.jpg", '{"vase"')),
        (ss.stylize, (SCENE, {"vase": 3}), ("styles", "dict of int")),
        (ss.train, (SCENE,), ("capture", "Capture", "Scene", "`load`")),
        (ss.select, (SCENE, 3), ("name", "str", "int", "3")),
        (ss.sheet, (SCENE, "vase", "wave.jpg"), ("styles", "Sequence", "wave.jpg")),
        (ss.open, (SCENE,), ("path", "Path or str", "Scene")),
        (ss.compare, ({"a": "folder"},), ("scenes", "dict of str")),
    ],
)
def test_the_message_names_the_fact(verb: Any, arguments: tuple[Any, ...], facts: tuple[str, ...]):
    with pytest.raises(StyleSplatError) as caught:
        verb(*arguments)
    assert all(fact in str(caught.value) for fact in facts), caught.value


def test_a_generator_refuses_at_the_call():
    with pytest.raises(StyleSplatError, match="`style`"):
        ss.stylize_live(SCENE, "vase", "wave.jpg")  # pyright: ignore
