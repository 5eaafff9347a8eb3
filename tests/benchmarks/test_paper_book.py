"""The paper's figures: what is computed is kept, and only that is told."""

from pathlib import Path

import pytest
import torch
from paper_figures import figure2
from paper_figures.book import Book, Cell, Outcome, work_through
from paper_figures.pictures import picture
from paper_figures.story import (
    Figure,
    Grid,
    Heading,
    Points,
    Row,
    Table,
    Text,
    html_page,
    markdown_page,
)
from paper_figures.subject import cut

from stylesplat.figures.grid import CELL
from stylesplat.io.images import write_image

PICTURE = torch.rand(30, 40, 3, generator=torch.Generator().manual_seed(0))


def cells(calls: list[str], count: int = 3) -> list[Cell]:
    def computed(key: str) -> Outcome:
        calls.append(key)
        return Outcome({"number": 0.5, "nested": {"a": 1}}, {"a view": PICTURE})

    return [Cell("figure9", f"way {n:g}", lambda n=n: computed(f"{n:g}")) for n in range(count)]


def test_what_is_there_is_not_computed_again(tmp_path: Path):
    calls: list[str] = []
    book, some = Book(tmp_path, {"quick": True}), cells(calls)
    steps = work_through(book, some)
    assert [next(steps), next(steps)][1].startswith("figure9, way 1")  # interrupted then
    assert calls == ["0"]
    again = Book(tmp_path, {"quick": True})
    lines = [*work_through(again, some)]
    assert calls == ["0", "1", "2"] and len(lines) == 2
    assert lines[0] == "figure9, way 1: 1 of 2"
    found = again.results(some)["figure9"]["way 2"]
    assert found.numbers == {"number": 0.5, "nested": {"a": 1}} and found.seconds > 0
    assert found.processor_seconds >= 0
    assert found.pictures["a view"].is_file()


def test_how_long_the_rest_takes_is_said(tmp_path: Path):
    *_, last = work_through(Book(tmp_path, {}), cells([], 5))
    assert last == "figure9, way 4: 5 of 5, about 0 min left"


def test_half_a_cell_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object) -> None:
        raise OSError("full")

    book, some = Book(tmp_path, {}), cells([], 1)
    monkeypatch.setattr("paper_figures.book.write_image", full)
    with pytest.raises(OSError, match="full"):
        book.keep(some[0])
    assert not book.has(some[0]) and book.results(some) == {}


def test_results_of_other_settings_are_not_mixed(tmp_path: Path):
    Book(tmp_path, {"quick": True})
    with pytest.raises(SystemExit, match="holds results of other settings"):
        Book(tmp_path, {"quick": False})
    assert Book(tmp_path).settings["quick"] is True, "those that are there"
    with pytest.raises(SystemExit, match="holds no results yet"):
        Book(tmp_path / "nothing")


def test_keys_that_differ_in_signs_have_files_of_their_own(tmp_path: Path):
    book = Book(tmp_path, {})
    for key in ("a b", "a, b", "a-b"):
        book.keep(Cell("f", key, lambda key=key: Outcome({"key": key})))
    some = [Cell("f", key, lambda: Outcome({})) for key in ("a b", "a, b", "a-b")]
    assert [r.numbers["key"] for r in book.results(some)["f"].values()] == ["a b", "a, b", "a-b"]


def test_pages_hold_what_they_tell(tmp_path: Path):
    book, (cell, *_) = Book(tmp_path / "book", {}), cells([])
    book.keep(cell)
    picture = book.results([cell])["figure9"]["way 0"].pictures["a view"]
    blocks = [Text("1 < 2"), Table(("", "x"), [["y", "0.5"]]), Row({"left": picture, "b": picture})]
    intro = [Heading("So & so"), Points(["One.", "Two."])]
    figure = Figure("figure9", "A figure", "claims & such.", lambda _: [], lambda _: [])
    chapters = [("demo", [(figure, blocks)])]
    page = html_page("T", intro, chapters)
    assert page.count("data:image/jpeg;base64,") == 2 and "1 &lt; 2" in page
    assert "claims &amp; such." in page and "://" not in page
    text = markdown_page("T", intro, chapters, tmp_path / "paper")
    assert "<h2>So &amp; so</h2>" in page and "<li>Two.</li>" in page
    assert "## So & so\n\n- One.\n- Two.\n\n" in text
    assert "| y | 0.5 |" in text and "## A figure (demo)" in text
    assert "(paper/demo-figure9-2.jpg)" in text and "Left to right: left; b." in text
    assert (tmp_path / "paper" / "demo-figure9-2.jpg").stat().st_size < 20_000


def test_photos_of_others_scenes_stay_out_of_docs(tmp_path: Path):
    file = tmp_path / "picture.png"
    write_image(PICTURE.mul(255).byte(), file)
    figure = Figure("figure9", "A figure", "claims.", lambda _: [], lambda _: [])
    row = Row({"photo": file, "label map": file, "object": file})
    for scene, shown in (("demo", "photo; label map; object."), ("fox", "object.")):
        text = markdown_page("T", [], [(scene, [(figure, [row])])], tmp_path / scene)
        assert f"Left to right: {shown}" in text


def test_a_grid_is_one_picture_with_a_cell_for_each(tmp_path: Path):
    colours = {"red": (1.0, 0.0, 0.0), "blue": (0.0, 0.0, 1.0)}
    files = {name: tmp_path / f"{name}.png" for name in colours}
    for name, file in files.items():
        write_image(torch.tensor(colours[name]).expand(CELL, CELL, 3).mul(255).byte(), file)
    rows = {"rate 1": {"scale 1": files["red"], "scale 2": files["blue"]}}
    figure = Figure("figure9", "A figure", "claims.", lambda _: [], lambda _: [])
    chapters = [("demo", [(figure, [Grid("Scale across", rows)])])]
    assert html_page("T", [], chapters).count("data:image/jpeg;base64,") == 1
    assert "![Scale across](paper/demo-figure9-0.jpg)" in markdown_page(
        "T", [], chapters, tmp_path / "paper"
    )
    drawn = picture(tmp_path / "paper" / "demo-figure9-0.jpg").float() / 255
    for colour in colours.values():
        near = (drawn - torch.tensor(colour)).abs().amax(dim=-1) < 0.1
        assert int(near.sum()) == pytest.approx(CELL**2, rel=0.1)


def test_figures_without_results_tell_nothing():
    assert figure2.told({}) == []


def test_a_cut_holds_the_mask_and_some_around():
    mask = torch.zeros(30, 40, dtype=torch.bool)
    mask[10:14, 20:28] = True
    assert torch.equal(cut(PICTURE, mask), PICTURE[8:16, 18:30]), "a quarter of 8 pixels"
