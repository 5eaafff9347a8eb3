"""JSON and YAML whose values are other than expected."""

import json
import random
from collections.abc import Callable
from copy import deepcopy
from typing import Any

DEEP = 3000  # brackets: more than Python's recursion limit
LONG = 6000  # digits: more than Python converts
DEEPLY, LONGEST = "~deeply nested~", "~digits~"  # stand for what `json.dumps` cannot write
# As JSON, a line of values after the other; NaN and Infinity are Python's
NASTY = json.loads(f"""[
    null, true, false, 0, -1, 1, 3, 2147483648, 9223372036854775808, -9223372036854775808,
    18446744073709551616, 1{"0" * 400}, -200000, 200000, 0.5, -0.0, 1e-320, 1e38, 1e308, -1e308,
    NaN, Infinity, -Infinity, "", " ", "a", "12", "1e400", "\\u0000", "\\ud800", "\\u00e9",
    "{"x" * 300}", "{"x" * 100_000}", "../../x", "/etc/passwd", "..", ".", "a/../../b.png",
    "C:\\\\x", "__metadata__", "a=b\\n", [], {{}}, [null], [[]], [0], [1, 2], [-2, -2],
    [[1, 2], [3]], {{"a": 1}}, [1e308, 1e308, 1e308, 1e308], ["a", 1], "{DEEPLY}", "{LONGEST}"
]""")
COUNTS = json.loads(f"""[
    [4611686018427387904, 4611686018427387904, 4611686018427387904, 4611686018427387904, 4],
    [9223372036854775808, 9223372036854775808, 12], [18446744073709551628], [1{"0" * 400}],
    [4294967296, 4294967296, 4294967296], [-4, 16], [12], [], [{"0, " * 1000} 12], [2.5, 9.5],
    ["12"], [[6, 6]], [[6], [6]], [null], [true, true], {{}}, null, 12, "", "0", "{"o" * 500}",
    "\\u007f\\u007f\\u007f\\u007f", "PPPPPPPPPPPPPPPPPPPP0", "\\u00e9\\ud800", [NaN],
    [1e308, 1e308], [268435456], [2147483647, 2147483647], "{DEEPLY}", "{LONGEST}"
]""")
SIZES = json.loads("""[
    [-2, -2], [2147483648, 2147483648], [4294967296, 4294967296], [16384, 16384], [2, 2], [0, 0],
    [1e308, 1], [2.5, 3], [NaN, 3], [2], [1, 2, 3], [[3], [4]], ["3", "4"], null, "34", {}, 12
]""")
YAML_VALUES = (
    *"""2024-13-45
0000-00-00
!!int x
!!bool x
!!float x
!!timestamp 99
!!set {a}
!!binary =
!!python/object/apply:os.system [echo]
!!map [a]
!!seq {a: 1}
!!str 1
&a [*a]
&a {b: *a}
*missing
<<: 1
{<<: [1]}
? a
~
=
1:2:3
.inf
-.inf
.nan
1e400
[0.5, .nan]
'
"\\ud800"
%YAML 9
no
0o7""".splitlines(),
    "[" * 500,
    "{a: " * 500,
    "1" * LONG,
    "0x" + "f" * LONG,
    "- a\n- b",
    "--- a\n--- b",
    "\t",
    "\x07",
)


def json_mutant(content: bytes, random_: random.Random) -> bytes:
    """The same with one to three values, keys or items changed."""
    holder = {"": json.loads(content)}  # so that the whole can be replaced too
    for _ in range(random_.choice((1, 1, 1, 2, 3))):
        _change(holder, random_)
    return _written(holder.get(""))


def coco_mutant(content: bytes, random_: random.Random) -> bytes:
    """COCO's annotations with other run lengths or sizes."""
    whole = json.loads(content)
    for annotation in random_.choices(whole["annotations"], k=2):
        mask = annotation["segmentation"]
        if isinstance(mask["counts"], list) and random_.random() < 0.2:  # the sum wraps around
            mask["counts"] = [2**62] * 4 + mask["counts"]
            continue
        if random_.random() < 0.6:
            mask["counts"] = nasty(random_, COUNTS)
        if random_.random() < 0.6:
            mask["size"] = nasty(random_, SIZES)
    return _written(whole)


def yaml_mutant(content: bytes, random_: random.Random) -> bytes:
    """A text with another value on a line, or JSON, which is YAML too, of another structure."""
    if random_.random() < 0.4:
        import yaml

        return json_mutant(json.dumps(yaml.safe_load(content)).encode(), random_)
    lines = content.decode().splitlines()
    row = random_.randrange(len(lines))
    key, colon, _ = lines[row].partition(":")
    text = random_.choice(YAML_VALUES)
    changed = (f"{key}{colon} {text}", text, f"{lines[row]} {text}", f"{text}: 1", f"x: {text}")
    lines[row : row + 1] = [random_.choice(changed)]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def nasty(random_: random.Random, values: list[Any] = NASTY) -> Any:
    """One of them, which may be changed further."""
    return deepcopy(random_.choice(values))


def _change(holder: dict[str, Any], random_: random.Random) -> None:
    parent, key = random_.choice([*_places(holder)])
    random_.choice(CHANGES)(parent, key, random_)


def _places(parent: Any) -> Any:
    """Every place of a value, as what holds it and where in there."""
    pairs = list(parent.items() if isinstance(parent, dict) else enumerate(parent))
    for key, value in pairs:
        yield parent, key
        if isinstance(value, dict | list):
            yield from _places(value)


def _replace(parent: Any, key: Any, random_: random.Random) -> None:
    parent[key] = nasty(random_)


def _delete(parent: Any, key: Any, random_: random.Random) -> None:
    if key != "":
        del parent[key]


def _double(parent: Any, key: Any, random_: random.Random) -> None:
    """An item twice, or a value within itself."""
    if isinstance(parent, list):
        parent.insert(key, parent[key])
    else:
        parent[key] = {"same": parent[key], key: parent[key]}


def _add(parent: Any, key: Any, random_: random.Random) -> None:
    value = nasty(random_)
    if isinstance(parent[key], dict):
        parent[key][str(nasty(random_))[:400]] = value
    elif isinstance(parent[key], list):
        parent[key].append(value)
    else:
        parent[key] = [parent[key], value]


def _swap(parent: Any, key: Any, random_: random.Random) -> None:
    """Two values beside each other, or a number as a text."""
    others = list(parent if isinstance(parent, dict) else range(len(parent)))
    other = random_.choice(others)
    if other == key:
        parent[key] = str(parent[key])
    parent[key], parent[other] = parent[other], parent[key]


Change = Callable[[Any, Any, random.Random], None]
CHANGES: tuple[Change, ...] = (
    _replace,
    _replace,
    _replace,
    _replace,
    _delete,
    _double,
    _add,
    _swap,
)


def _written(value: Any) -> bytes:
    text = json.dumps(value)
    text = text.replace(f'"{DEEPLY}"', "[" * DEEP + "]" * DEEP)
    return text.replace(f'"{LONGEST}"', "9" * LONG).encode()
