"""The figures and claims of the paper on three balls, whose selection and changes are known."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest
import torch
from paper import FIGURES
from paper_figures import figure2, figure5, foreword, official, segmenting
from paper_figures.book import Book, Cell, Result, work_through
from paper_figures.claims import CLAIMS, verdicts
from paper_figures.masked_change import changed_share, masked_psnr, strength
from paper_figures.subject import Effort, Subject

from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from scenes import rand
from stylesplat.io.captures.capture_folder import load
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.selection.labels import pick
from stylesplat.stylization.features import load_weights

LARGE = CAMERAS.downscale(1 / 4)
EFFORT = Effort(2, 3, 192, whole_grid=False, trained=False, draft=True, judged=2, training_steps=12)
PICTURE = rand(30, 40, 3)
MASK = torch.zeros(30, 40, dtype=torch.bool)
MASK[5:15, 10:20] = True


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    photos = load(write_ball_capture(tmp_path_factory.mktemp("capture") / "balls", LARGE))
    red = SceneObject(pick(SPLATS, object_id=3), Selection(ids=(3,)))
    held_out, info = LARGE.names[:2], {"settings": {"max_gaussians": 300, "segment": "joint"}}
    metrics = {"steps": 1234, "psnr": 30.0, "ssim": 0.9}
    scene = Scene(
        SPLATS, LARGE, held_out=held_out, objects={"red": red}, info=info, metrics=metrics
    )
    style = rand(96, 96, 3)
    styles = {"noise": style, "other": style.flip(-1)}
    return Subject("balls", scene, photos, photos, styles, load_weights("compact", depth=3), EFFORT)


def results(**figures: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Result]]:
    return {
        figure: {key: Result(numbers, {}, 1.0, 1.0) for key, numbers in found.items()}
        for figure, found in figures.items()
    }


def judged(found: dict[str, dict[str, Result]]) -> list[bool]:
    words, numbers = verdicts({"demo": found})
    assert [row[0] for row in words.rows] == [row[0] for row in numbers.rows]
    assert all(re.search(r"\d", row[1]) for row in numbers.rows)
    return [row[1] == "holds" for row in words.rows]


@pytest.mark.parametrize(("masked", "lifted", "holds"), [(0.5, 0.0, True), (0.5, 0.4, False)])
def test_claims_are_judged_by_numbers(masked: float, lifted: float, holds: bool):
    shares = {f"{figure2.MASKED} at 1": masked, f"{figure2.LIFTED} at 1": lifted}
    found = {key: {"changed_far": share, "content_ssim": 0.5} for key, share in shares.items()}
    assert judged(results(figure2=found))[0] is holds
    formula = {official.PRINTED: {"nnfm": 0.3}, "none": {"nnfm": 0.2}}
    ways = {segmenting.JOINT: {"miou": 0.8}, segmenting.LIFTED: {"miou": 0.9}}
    assert judged(results(official=formula, segmenting=ways)) == [False, False]
    assert judged({}) == [], "nothing measured"


def test_an_edit_counts_on_its_side_of_the_mask_only():
    after = PICTURE.clone()
    after[5:15, 20:25] += 0.1  # 50 pixels, all outside
    assert changed_share(PICTURE, after, MASK) == 0 == strength(PICTURE, after, MASK)
    assert changed_share(PICTURE, after, ~MASK) == pytest.approx(50 / 1100)
    expected = -10 * torch.tensor(0.1**2 * 50 / 1100).log10().item()
    assert masked_psnr(PICTURE, after, ~MASK) == pytest.approx(expected, abs=1e-3)
    black, none = torch.zeros_like(PICTURE), torch.zeros_like(MASK)
    assert strength(black, 1 - black, MASK) == pytest.approx(100, abs=0.05)  # rounded matrices
    assert masked_psnr(black, 1 - black, none) == pytest.approx(120)
    assert changed_share(black, 1 - black, none) == 0 == strength(black, 1 - black, none)


def measured(cells: list[Cell], keys: Iterable[str], folder: Path) -> dict[str, Mapping[str, Any]]:
    """The numbers of some cells."""
    book, some = Book(folder, {}), [cell for cell in cells if cell.key in {*keys}]
    assert len([*work_through(book, some)]) == len(some) > 0
    (found,) = book.results(some).values()
    return {key: outcome.numbers for key, outcome in found.items()}


def test_selection_in_3d_changes_its_gaussians_alone(subject: Subject, tmp_path: Path):
    keys = [f"{way} at 1" for way in (figure2.MASKED, figure2.STRICT, figure2.LIFTED)]
    found = measured(figure2.cells(subject), ["initial", *keys], tmp_path)
    masked, strict, lifted = (found[key] for key in keys)
    assert lifted["changed_gaussians"] <= int(subject.picked(subject.ids[0]).sum())
    assert masked["changed_gaussians"] > strict["changed_gaussians"] > lifted["changed_gaussians"]
    assert lifted["outside_psnr"] > masked["outside_psnr"]


def test_two_objects_together_are_the_two_alone(subject: Subject, tmp_path: Path):
    cells = figure5.cells(subject)
    keys = [cell.key for cell in cells if cell.key.endswith("paper")]
    for numbers in measured(cells, keys, tmp_path).values():
        assert numbers["changed_elsewhere"] == 0
        assert {*numbers["differing"].values()} == {0}


def test_faults_of_the_official_code_are_what_they_are_called(subject: Subject, tmp_path: Path):
    labels = torch.zeros(40, 40, dtype=torch.int64)
    labels[:, 17:] = 200
    small = official.bicubic_labels(labels, (30, 20))
    assert {*small.unique().tolist()} - {0, 200}, "ids that were not there"
    assert official.squashed(torch.rand(50, 50, 3), (32, 18)).shape == (32, 18, 3)
    found = measured(official.cells(subject), ["none", official.BLACK], tmp_path)
    plain, black = found["none"], found[official.BLACK]
    assert plain["mask_iou"] == black["mask_iou"] and plain["strength"] != black["strength"]


def test_the_page_says_what_is_written_here():
    page = (Path(__file__).parents[2] / "docs/paper.md").read_text(encoding="utf-8")
    said = (foreword.ABOUT, foreword.RELATED, foreword.DEFINED, foreword.NOT_RUN, foreword.CREDITS)
    figures = [f"The paper: {figure.claim}" for figure in FIGURES.values()]
    assert not [text for text in (*said, *figures) if text not in page]
    assert not [claim.text for claim in CLAIMS if page.count(f"| {claim.text} |") != 2]
