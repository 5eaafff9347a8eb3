"""Damaged and hostile files as hypothesis strategies: what somebody makes of a valid file."""

import json
import struct
from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml
from hypothesis import strategies as st

INTEGERS = (0, 1, -1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, -(2**63), 10**6)
FLOATS = (float("nan"), float("inf"), -1e308, 1e308, 1e38, 1e-320)
NAMES = ("../../x", "/etc/passwd", "..", "a/../../b.png", "\0", "\ud800", "x" * 5000, "a=b\n")
YAML_VALUES = (
    *("2024-13-45", "!!timestamp 99", "!!set {a}", "!!binary =", "!!map [a]", "*missing", "<<: 1"),
    *("!!python/object/apply:os.system [echo]", "&a [*a]", "? a", ".nan", "1e400", "'", "%YAML 9"),
    *("--- a\n--- b", "\x07", "1" * 6000, "[" * 500, "{a: " * 500),
)

odd = st.sampled_from((None, True, 0.5, 1, -1, 3, 10**400, *INTEGERS, *FLOATS, *NAMES))
values = st.recursive(
    odd | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=6,
)
"""Anything that JSON can hold, and the NaN and Infinity of Python's."""


def damaged(path: Path) -> st.SearchStrategy[bytes]:
    """Contents to put in place of a valid file's, by the file's suffix."""
    content = path.read_bytes()
    anywhere = cut(content) | flipped(content) | overwritten(content)
    if path.suffix in (".json", ".gltf"):
        return anywhere | changed_json(json.loads(content))
    if path.suffix == ".yaml":
        return anywhere | changed_json(yaml.safe_load(content)) | changed_lines(content.decode())
    if path.suffix in (".safetensors", ".glb"):
        return anywhere | changed_header(content, path.suffix)
    return anywhere


def cut(content: bytes) -> st.SearchStrategy[bytes]:
    beginnings = st.integers(0, max(len(content) - 1, 0)).map(lambda length: content[:length])
    return beginnings | st.binary(min_size=1, max_size=9).map(lambda more: content + more)


def flipped(content: bytes) -> st.SearchStrategy[bytes]:
    def flip(bits: list[int]) -> bytes:
        changed = bytearray(content)
        for bit in bits:
            changed[bit // 8] ^= 1 << bit % 8
        return bytes(changed)

    # A header, which decides how the rest is read, as often as the rest
    last = 8 * len(content) - 1
    places = (
        st.integers(0, min(last, 1000))
        | st.integers(max(0, last - 1000), last)
        | st.integers(0, last)
    )
    return st.lists(places, min_size=1, max_size=8).map(flip)


def overwritten(content: bytes) -> st.SearchStrategy[bytes]:
    """A file with a number of 4 or 8 bytes that is too large, negative or not one."""

    def write(place: int, number: bytes) -> bytes:
        return content[:place] + number + content[place + len(number) :]

    numbers = [struct.pack("<q", number) for number in INTEGERS]
    numbers += [struct.pack("<I", number % 2**32) for number in INTEGERS]
    numbers += [struct.pack("<d", number) for number in FLOATS]
    places = st.integers(0, max(len(content) - 1, 0))
    return st.builds(write, places, st.sampled_from(numbers))


def changed_json(whole: Any) -> st.SearchStrategy[bytes]:
    """JSON with another value, without a key, or with a key more, in one to three places."""
    places = [*_places(whole)]
    changes = st.tuples(st.sampled_from(places), st.sampled_from(("set", "delete", "add")), values)

    def change(chosen: list[Any]) -> bytes:
        holder = {"": deepcopy(whole)}
        for path, how, value in chosen:
            _change(holder, path, how, value)
        return json.dumps(holder.get("")).encode("utf-8", "surrogatepass")

    deep = st.sampled_from((b"[" * 3000, b'{"a":' * 3000, b"1" * 6000, b"", b"null", b"[]", b"{}"))
    return st.lists(changes, min_size=1, max_size=3).map(change) | deep


def _places(value: Any, path: tuple = ("",)) -> Any:
    yield path
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value[:4])
        if isinstance(value, list)
        else ()
    )
    for key, item in items:
        yield from _places(item, (*path, key))


def _change(holder: Any, path: tuple, how: str, value: Any) -> None:
    try:
        for key in path[:-1]:
            holder = holder[key]
        if how == "delete":
            del holder[path[-1]]
        elif how == "add" and isinstance(holder[path[-1]], dict):
            holder[path[-1]]["unknown"] = value
        else:
            holder[path[-1]] = value
    except (KeyError, IndexError, TypeError):
        pass  # an earlier change took it away


def changed_lines(text: str) -> st.SearchStrategy[bytes]:
    lines = text.splitlines()

    def change(row: int, value: str, whole: bool) -> bytes:
        key, colon, _ = lines[row].partition(":")
        line = value if whole else f"{key}{colon} {value}"
        return "\n".join([*lines[:row], line, *lines[row + 1 :]]).encode()

    rows = st.integers(0, len(lines) - 1)
    return st.builds(change, rows, st.sampled_from(YAML_VALUES), st.booleans())


def changed_header(content: bytes, suffix: str) -> st.SearchStrategy[bytes]:
    """Safetensors or GLB with a JSON header that says something else about the same bytes."""
    start, length = (8, "<Q") if suffix == ".safetensors" else (20, "<I")
    (size,) = struct.unpack_from(length, content, 0 if suffix == ".safetensors" else 12)
    header, rest = json.loads(content[start : start + size]), content[start + size :]

    def put(new: bytes) -> bytes:
        new += b" " * (-len(new) % 8)
        if suffix == ".safetensors":
            return struct.pack("<Q", len(new)) + new + rest
        total = struct.pack("<I", 20 + len(new) + len(rest))
        return content[:8] + total + struct.pack("<I", len(new)) + content[16:20] + new + rest

    return changed_json(header).map(put)
