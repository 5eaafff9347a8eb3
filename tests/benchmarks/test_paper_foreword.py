"""What was run is said by the scenes' and the results' own files."""

from dataclasses import replace
from pathlib import Path

from paper_figures.book import Book, Cell, Outcome
from paper_figures.foreword import Run, foreword
from paper_figures.story import Table, Text
from paper_figures.subject import MEDIUM, Subject

from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from stylesplat.scene.scene import Scene
from stylesplat.stylization.features.weights import load_weights
from stylesplat.verbs.load import load


def made(folder: Path, **settings: object) -> Run:
    photos = load(write_ball_capture(folder / "balls"))
    info = {"settings": {"segment": "lift", **settings}}
    scene = Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:2], info=info, metrics={"steps": 1234})
    network = load_weights("compact", depth=3)
    subject = Subject("balls", scene, photos, None, {}, network, MEDIUM)
    book = Book(folder / "book", {"effort": "medium", "features": "compact"})
    cells = [Cell("figure9", key, lambda: Outcome({"number": 1})) for key in ("a", "b")]
    book.keep(cells[0])
    return Run(subject, book, cells)


def tables(run: Run) -> list[list[str]]:
    """The lines on training and on computing."""
    trained, computed, *_ = (b for b in foreword([run]) if isinstance(b, Table))
    return [[*trained.rows[0]], [*computed.rows[0]]]


def test_training_and_computing_are_told_as_files_have_them(tmp_path: Path):
    trained, computed = tables(made(tmp_path))
    width, height = CAMERAS.size
    assert trained == ["balls", f"{width}x{height}", f"{len(SPLATS):,}", "1,234", "lifted"]
    steps, side = str(MEDIUM.steps), f"{MEDIUM.side} px"
    middle = ["balls", "medium", steps, str(MEDIUM.masked_steps), side, "2", "1 of 2 parts"]
    assert computed[:-1] == middle and int(computed[-1]) >= 0


def test_smaller_photos_and_joint_training_are_said(tmp_path: Path):
    run = made(tmp_path, segment="joint")
    smaller = replace(run.subject, scene=replace(run.subject.scene, downscale=2.0))
    trained, _ = tables(replace(run, subject=smaller))
    assert trained[1].endswith(", 1/2 of their size") and trained[-1] == "learned with the colours"


def test_scenes_without_exact_maps_and_drafts_are_named(tmp_path: Path):
    run = made(tmp_path)
    text = " ".join(block.text for block in foreword([run]) if isinstance(block, Text))
    assert "balls has no exact label maps" in text and "ours are the default." in text
    draft = replace(run.subject, effort=replace(MEDIUM, draft=True))
    text = " ".join(
        block.text for block in foreword([replace(run, subject=draft)]) if isinstance(block, Text)
    )
    assert "drafts (`--quality draft`) for balls" in text
