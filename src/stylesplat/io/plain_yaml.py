"""YAML for recipes and job files: texts, numbers, lists, and maps with text keys; JSON too."""

import re
from collections.abc import Iterable, Iterator
from typing import Any, ClassVar

import yaml

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason

INSTEAD = "Give a YAML file, or the recipe.json of a styled scene."
MAX_YAML = 2**19  # bytes; a recipe of ten objects has 10,000, and a million may take a minute
MAX_DEPTH = 20  # of lists and maps in each other: recipes have 4
MAX_VALUES = 100_000  # those that references repeat included
TOO_DEEP = f"lists and maps lie more than {MAX_DEPTH} deep in each other"

TEXT, NULL, BOOL, INT, FLOAT, MERGE = (
    f"tag:yaml.org,2002:{name}" for name in ("str", "null", "bool", "int", "float", "merge")
)
# What is no text though it has no quotes, by its first character. JSON's 1e-05 is a number, unlike
# in YAML 1.1; dates, hours:minutes, 007 and whole numbers that are too long for Python are not
PLAIN = (
    (NULL, "", ""),
    (NULL, "~|null", "~nN"),
    (BOOL, "(yes|no|true|false|on|off)", "yYnNtTfFoO"),
    (INT, "[-+]?(0|[1-9][0-9_]{0,4000})", "-+0123456789"),
    (FLOAT, r"[-+]?(0|[1-9][0-9]*)(\.[0-9]*)?(e[-+]?[0-9]+)?", "-+0123456789"),
    (FLOAT, r"[-+]?\.([0-9]+(e[-+]?[0-9]+)?|inf|nan)", "-+."),
    (MERGE, "<<", "<"),
)


def parse_yaml(text: str | bytes) -> Any:
    """Read YAML or JSON; keys become texts. Tags and other features without use are refused."""
    if len(text) > MAX_YAML:
        raise StyleSplatError(
            f"it is longer than recipes are: {MAX_YAML} bytes at most. Check the name."
        )
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise StyleSplatError(f"line {line} is no valid YAML: {error.problem}. Mend it.") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # the last of "\\U99999999"
        raise StyleSplatError(f"it is no YAML text: {reason(error)}. {INSTEAD}") from error


Place = tuple[str | int, ...]  # the keys and numbers that lead to a value


def lines_of(text: str | bytes) -> dict[Place, int]:
    """The line, from 1, of each key and list item; what an alias repeats has its first line."""
    loader = _Loader(text)
    try:
        root = loader.get_single_node()
    finally:
        loader.dispose()
    return {} if root is None else dict(_lines(root, ()))


def _lines(node: Any, place: Place) -> Iterator[tuple[Place, int]]:
    if isinstance(node, yaml.ScalarNode):
        return
    pairs: Iterable[Any] = node.value
    if isinstance(node, yaml.SequenceNode):
        pairs = ((number, item) for number, item in enumerate(node.value))
    for key, value in pairs:
        if isinstance(key, yaml.ScalarNode) and key.tag == MERGE:
            continue
        mark = value.start_mark if isinstance(key, int) else key.start_mark
        inner = (*place, key if isinstance(key, int) else key.value)
        yield inner, mark.line + 1
        yield from _lines(value, inner)


class _Loader(yaml.SafeLoader):
    """Keys are unique texts, so that `3:` and `no:` are names; no tags; aliases within bounds."""

    yaml_implicit_resolvers: ClassVar = {}

    def get_single_node(self) -> Any:
        node = super().get_single_node()
        if node is not None:
            _measured(node, {})
        return node

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        if getattr(event, "tag", None) is not None:
            raise _refused("tags such as !name are not for recipes", event)
        self.depth = getattr(self, "depth", 0) + 1
        if self.depth > MAX_DEPTH:
            raise _refused(TOO_DEEP, event)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        mapping = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in mapping.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refused("a key is a list or a map", key)
            if key.tag == MERGE:
                continue
            key.tag = TEXT
            if key.value in seen:
                raise _refused(f"{key.value} is listed twice", key)
            seen.add(key.value)
        return mapping

    def construct_scalar(self, node: Any) -> str:
        # JSON escapes characters beyond 16 bits as two, which YAML leaves apart
        text = super().construct_scalar(node)
        return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def _measured(node: Any, known: dict[int, tuple[int, int] | None]) -> tuple[int, int]:
    """The number of values below a node, aliases expanded, and their depth; None while inside."""
    if id(node) not in known:
        known[id(node)] = None
        inside = [] if isinstance(node, yaml.ScalarNode) else node.value
        nodes = [each for item in inside for each in (item if isinstance(item, tuple) else [item])]
        found = [_measured(each, known) for each in nodes]
        count = 1 + sum(values for values, _ in found)
        depth = 1 + max((below for _, below in found), default=0)
        if count > MAX_VALUES or depth > MAX_DEPTH:
            raise _refused(TOO_DEEP if depth > MAX_DEPTH else "it stands for too many values", node)
        known[id(node)] = count, depth
    measured = known[id(node)]
    if measured is None:
        raise _refused("it holds itself", node)
    return measured


def _refused(problem: str, where: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=where.start_mark)


for _tag, _pattern, _first in PLAIN:
    _Loader.add_implicit_resolver(_tag, re.compile(rf"(?i:{_pattern})\Z"), list(_first) or [""])
