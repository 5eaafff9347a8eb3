"""YAML for recipes and job files: texts, numbers, lists, and maps with text keys; JSON too."""

import re
from typing import Any, ClassVar

import yaml

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason

INSTEAD = "Give a YAML file, or the recipe.json of a styled scene."
MAX_YAML = 2**19  # bytes; a recipe of ten objects has 10,000, and a million may take a minute
MAX_DEPTH = 20  # of lists and maps in each other: recipes have 4
MAX_VALUES = 100_000  # those that aliases repeat included
TOO_DEEP = f"lists and maps are nested more than {MAX_DEPTH} deep"

TAGS = NULL, BOOL, INT, FLOAT, *_ = tuple(
    f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str", "seq", "map")
)
MERGE = "tag:yaml.org,2002:merge"
# Scalars without quotes that are no text, by their first character. JSON's 1e-05 is a number,
# unlike in YAML 1.1; dates, hours:minutes, 007 and whole numbers too long for Python are texts
PLAIN = (
    (NULL, "", ""),
    (NULL, "~|null", "~nN"),
    (BOOL, "(yes|no|true|false|on|off)", "yYnNtTfFoO"),
    (INT, "[-+]?(0|[1-9][0-9_]{0,4000})", "-+0123456789"),
    (FLOAT, r"[-+]?(0|[1-9][0-9]*)(\.[0-9]*)?(e[-+]?[0-9]+)?", "-+0123456789"),
    (FLOAT, r"[-+]?\.([0-9]+(e[-+]?[0-9]+)?|inf|nan)", "-+."),
    (MERGE, "<<", "<"),
)
Place = tuple[str | int, ...]
"""The keys and numbers that lead to a value."""


def parse_yaml(text: str | bytes) -> Any:
    """Read YAML or JSON; keys become texts. Tags and other features without use are refused."""
    return _parse(text)[0]


def lines_of(text: str | bytes) -> dict[Place, int]:
    """The line, from 1, of each key and list item; what an alias repeats has its first line."""
    return _parse(text)[1]


def _parse(text: str | bytes) -> tuple[Any, dict[Place, int]]:
    if len(text) > MAX_YAML:
        raise StyleSplatError(
            f"it is longer than recipes are: {MAX_YAML} bytes at most. Check the name."
        )
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        return (None if node is None else loader.plain(node, ())), loader.lines
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise StyleSplatError(f"line {line} is no valid YAML: {error.problem}. Mend it.") from error
    except RecursionError as error:
        raise StyleSplatError(f"it is no valid YAML: {TOO_DEEP}. Mend it.") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # the last of "\\U99999999"
        raise StyleSplatError(f"it is no YAML text: {reason(error)}. {INSTEAD}") from error


class _Loader(yaml.SafeLoader):
    """Keys are unique texts, so that `3:` and `no:` are names; no tags; aliases within bounds."""

    yaml_implicit_resolvers: ClassVar = {}

    def __init__(self, text: str | bytes) -> None:
        super().__init__(text)
        self.lines, self.count = dict[Place, int](), 0

    def plain(self, node: yaml.Node, place: Place) -> Any:
        """The value of a node, and the lines of what is in it."""
        self.count += 1
        if self.count > MAX_VALUES or len(place) > MAX_DEPTH:
            raise _refused(TOO_DEEP if len(place) > MAX_DEPTH else "it holds too many values", node)
        if node.tag not in TAGS:
            raise _refused("tags such as !name are not for recipes", node)
        if isinstance(node, yaml.SequenceNode):
            found = []
            for number, item in enumerate(node.value):
                self.lines[(*place, number)] = item.start_mark.line + 1
                found.append(self.plain(item, (*place, number)))
            return found
        if isinstance(node, yaml.MappingNode):
            return self._map(node, place)
        return self.construct_object(node)

    def _map(self, node: yaml.MappingNode, place: Place) -> dict[str, Any]:
        own, merged = dict[str, Any](), dict[str, Any]()
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refused("a key is a list or a map", key)
            if key.tag == MERGE:
                for each in value.value if isinstance(value, yaml.SequenceNode) else [value]:
                    if not isinstance(each, yaml.MappingNode):
                        raise _refused("<< needs a mapping", each)
                    merged = self.plain(each, (*place, key.value)) | merged
                continue
            if key.value in own:
                raise _refused(f"{key.value} is listed twice", key)
            self.lines[(*place, key.value)] = key.start_mark.line + 1
            own[key.value] = self.plain(value, (*place, key.value))
        return merged | own

    def construct_scalar(self, node: Any) -> str:
        # JSON escapes characters beyond 16 bits as two, which YAML leaves apart
        text = super().construct_scalar(node)
        return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def _refused(problem: str, node: yaml.Node) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


for _tag, _pattern, _first in PLAIN:
    _Loader.add_implicit_resolver(_tag, re.compile(rf"(?i:{_pattern})\Z"), list(_first) or [""])
