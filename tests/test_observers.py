"""An observer cancels a verb by raising: the exception arrives, and nothing is half done."""

from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import pytest

import stylesplat as ss
from balls import CAMERAS, TRAINED, contents, painted, write_pictures
from stylesplat.progress import Observer, observed


class Cancelled(Exception):
    """Of the program that uses the library."""


class Stop(Observer):
    """Raises at an advance, or where work of some kind begins."""

    def __init__(self, advances: int) -> None:
        self.left, self.seen = advances, 0

    @contextmanager
    def task(self, what: str, total: object, unit: str, done: object):
        yield self

    def advance(self, amount: int | float = 1) -> None:
        self.seen += 1
        if self.seen > self.left:
            raise Cancelled


@pytest.mark.usefixtures("quick_painting")
def test_painting_ends_where_the_observer_raises_and_can_be_done_again(tmp_path: Path):
    picture = write_pictures(tmp_path)[0]
    for advances in (0, 9):
        with pytest.raises(Cancelled), observed(Stop(advances)):
            painted(TRAINED, "red", picture)
    assert [layer.name for layer in painted(TRAINED, "red", picture).layers] == ["red"]


def test_files_are_whole_or_not_there_where_the_observer_raises(tmp_path: Path):
    ss.save(TRAINED, tmp_path / "scene")
    before = contents(tmp_path)
    verbs: list[Callable[[], object]] = [
        lambda: [*ss.render(TRAINED, CAMERAS.names)],
        lambda: ss.export(TRAINED, tmp_path / "page.html"),
    ]
    for verb in verbs:
        with pytest.raises(Cancelled), observed(Stop(0)):
            verb()
    assert contents(tmp_path) == before
