"""What numbers say of the paper's sentences."""

from collections.abc import Mapping
from typing import Any

import pytest
from paper_figures import figure2, figure3, figure6, official, segmenting
from paper_figures.book import Result
from paper_figures.claims import verdicts
from paper_figures.story import Points, Table, Text


def results(**figures: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Result]]:
    return {
        figure: {key: Result(numbers, {}, 1.0, 1.0) for key, numbers in cells.items()}
        for figure, cells in figures.items()
    }


def said(found: dict[str, dict[str, Result]]) -> tuple[list[list[str]], list[str]]:
    _, table, _, against = verdicts({"demo": found})
    assert isinstance(table, Table)
    return [[*row] for row in table.rows], [*against.lines] if isinstance(against, Points) else []


def test_nothing_measured_is_nothing_said():
    *_, last = verdicts({"demo": {}})
    assert said({}) == ([], []) and last == Text("Nothing.")


@pytest.mark.parametrize(("masked", "lifted", "holds"), [(0.5, 0.0, True), (0.5, 0.4, False)])
def test_leakage_is_judged_beside_what_3d_leaves_alone(masked: float, lifted: float, holds: bool):
    cells = {f"{figure2.MASKED} at 1": masked, f"{figure2.LIFTED} at 1": lifted}
    found = {key: {"changed_far": share, "content_ssim": 0.5} for key, share in cells.items()}
    rows, against = said(results(figure2=found))
    assert rows[0][1].startswith("holds: " if holds else "does not: ")
    assert "50.00 % of the pixels change" in rows[0][1]
    assert holds != any("changes other parts" in line for line in against)


@pytest.mark.parametrize(("exact", "holds"), [(0.5, False), (0.01, True)])
def test_masks_are_not_to_blame_for_what_exact_ones_do(exact: float, holds: bool):
    shares = {f"{figure2.MASKED} at 0": exact, f"{figure2.MASKED} at 1": 0.6}
    found = {key: {"changed_far": share} for key, share in shares.items()}
    rows, against = said(results(figure2=found))
    assert [row[1].startswith("holds") for row in rows] == [holds] and bool(against) != holds


def test_style_is_confined_or_not():
    inside, beside = ({"changed_far": share} for share in (0.001, 0.2))
    rows, against = said(results(figure1={"a, paper": inside, "b, ours": beside}))
    assert len(rows) == 1 and rows[0][1].startswith("holds") and not against, "ours is not theirs"
    rows, against = said(results(figure1={"a, paper": inside, "b, paper": beside}))
    assert against == [
        "Style is confined to the selected object. Not so in demo (beyond 2 px 20.00 % of the "
        "pixels change at most)."
    ]


@pytest.mark.parametrize(("strokes", "holds"), [((2.0, 3.0, 4.0), True), ((2.0, 4.0, 3.0), False)])
def test_strokes_follow_scale_or_not(strokes: tuple[float, ...], holds: bool):
    pairs = zip(figure6.SCALES, strokes, strict=True)
    cells = {
        figure6._key((3, scale, 0.05)): {
            "group": 3, "scale": scale, "rate": 0.05,
            "stroke": stroke, "strength": 1.0, "content_ssim": 0.5,
        }
        for scale, stroke in pairs
    }  # fmt: skip
    rows, _ = said(results(figure6=cells))
    assert [row[1].startswith("holds") for row in rows] == [holds], "one value tells nothing"


@pytest.mark.parametrize(
    ("way", "how"),
    [("as trained", "after 1,250 steps of training"), ("lifted", "identities lifted")],
)
def test_the_threshold_is_judged_by_the_way_to_identities_that_was_run(way: str, how: str):
    numbers = {f"{figure3.THRESHOLD:g}, outliers kept": {"miou": 0.8}}
    numbers |= {f"{each:g}, outliers removed": {"miou": 1 - each} for each in figure3.THRESHOLDS}
    speed = {"speed": {"train_steps": 1250}}
    rows, _ = said(results(figure3={way: numbers}, figure7=speed))
    (line,) = (row[1] for row in rows if row[0].startswith("Gaussians are chosen"))
    assert line == f"does not: mIoU 0.050 at 0.95, 0.700 at 0.3, {how}"


def test_the_printed_formula_and_lifting():
    formula = {official.PRINTED: {"nnfm": 0.3}, "none": {"nnfm": 0.2}}
    ways = {segmenting.JOINT: {"miou": 0.8}, segmenting.LIFTED: {"miou": 0.9}}
    rows, against = said(results(official=formula, segmenting=ways))
    assert [row[1].startswith("does not") for row in rows] == [True, True]
    assert "NNFM 0.300 by it, 0.200 by ARF's" in against[0] and "mIoU 0.800, 0.900" in against[1]
