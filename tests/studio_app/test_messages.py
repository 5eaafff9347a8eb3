"""The page and the server speak one language: that of messages.py and the actions' signatures."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from browser import session_in
from stylesplat.studio_app import messages as m
from stylesplat.studio_app import server
from stylesplat.studio_app.actions import Actions
from stylesplat.studio_app.files import SceneStore
from stylesplat.studio_app.gallery import Gallery, StylePicture

PAGE = server.SERVER_PAGE
SCRIPTS = {path.name: path.read_text(encoding="utf-8") for path in sorted(PAGE.glob("*.js"))}
EVERYTHING = "\n".join(SCRIPTS.values())
NAME = r"[a-z][a-z_]*"
# Where the page reads a message, or a part of one, and by what names
READ = {
    m.Hello: [r"hello\.value"],
    m.StateMessage: [r"state\.value\??", r"\bnow"],
    m.Progress: [r"progress\.value"],
    m.Busy: [r"busy\.value"],
}
OF_SIGNALS = {"value", "peak"}


@pytest.fixture(scope="module")
def declared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, type[msgspec.Struct]]]:
    """All that a page may send, by its names."""
    session = session_in(tmp_path_factory.mktemp("session"))
    actions = Actions(session, Gallery(), SceneStore(session))
    yield {str(each.__struct_config__.tag): each for each in actions.requests}
    session.worker.close()


def calls(name: str) -> Iterator[tuple[str, str]]:
    """What stands in the calls of a function of the page: a name, and the object of fields."""
    for found in re.finditer(rf'\b{name}\("({NAME})"(?:, \{{)?', EVERYTHING):
        depth, end = 1, found.end()
        if not found[0].endswith("{"):
            yield found[1], ""
            continue
        while depth:
            depth += {"{": 1, "}": -1}.get(EVERYTHING[end], 0)
            end += 1
        yield found[1], EVERYTHING[found.end() : end - 1]


def keys(fields: str) -> set[str]:
    """The keys of an object in JavaScript, without those of what is inside of it."""
    while (flat := re.sub(r"\([^()]*\)|\[[^][]*\]|\{[^{}]*\}", "0", fields)) != fields:
        fields = flat
    found = set[str]()
    for part in fields.split(","):
        key = re.match(rf"\s*({NAME})\s*(?::|$)", part)
        if key:
            found.add(key[1])
    return found


def test_the_page_sends_nothing_that_is_not_declared(declared: dict[str, type[msgspec.Struct]]):
    sent = [*calls("act"), *calls("begin"), *calls("done")]
    assert len(sent) > 40
    for name, fields in sent:
        assert name in declared, name
        unknown = keys(fields) - {*declared[name].__struct_fields__}
        assert not unknown, (name, unknown)


def test_the_page_can_ask_for_all_that_is_declared(declared: dict[str, type[msgspec.Struct]]):
    quoted = set(re.findall(rf'"({NAME})"', EVERYTHING))
    assert {*declared} <= quoted, {*declared} - quoted
    words = set(re.findall(r"\w+", EVERYTHING))
    for name, struct in declared.items():
        assert {*struct.__struct_fields__} <= words, name


def parts_of(kind: Any) -> set[type[msgspec.Struct]]:
    """The structs in a type."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        inner = [field.type for field in msgspec.structs.fields(kind)]
        return {kind}.union(*map(parts_of, inner))
    return set[type[msgspec.Struct]]().union(*map(parts_of, getattr(kind, "__args__", ())))


def test_the_page_reads_all_that_the_server_sends_and_nothing_else():
    sent = {each.__struct_config__.tag: each for each in m.ServerMessage.__subclasses__()}
    table = re.search(r"const texts = \{(.*?)\n\};", SCRIPTS["connection.js"], re.DOTALL)
    assert table is not None
    assert {*re.findall(rf"^  ({NAME})(?=[:(])", table[1], re.MULTILINE)} == {*sent}
    words = set(re.findall(r"\w+", EVERYTHING))
    for struct in set[type[msgspec.Struct]]().union(*map(parts_of, sent.values())):
        missing = {*struct.__struct_fields__} - words
        assert not missing, (struct.__name__, missing)
    assert {*StylePicture.__dataclass_fields__} - {"path"} <= words
    for struct, names in READ.items():
        for name in names:
            used = set(re.findall(rf"{name}\.({NAME})\b", EVERYTHING)) - OF_SIGNALS
            for taken in re.findall(rf"const \{{ ([^}}]*) \}} = {name}(?![\w.])", EVERYTHING):
                used |= set(re.findall(rf"(?:^|, )({NAME})", taken))
            assert used and used <= {*struct.__struct_fields__}, (name, used)


def test_pictures_are_of_kinds_that_the_page_knows():
    source = Path(server.__file__).with_name("pictures.py").read_text(encoding="utf-8")
    kinds = set(re.findall(r'"(\w+)", content, look|binary_message\("(\w+)"', source))
    known = set(re.findall(r'\bon\("(\w+)"', EVERYTHING))
    assert known == {one or other for one, other in kinds}
