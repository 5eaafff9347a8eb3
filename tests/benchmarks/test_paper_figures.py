"""The paper's figures on three balls, whose selection and changes are known."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numba
import pytest
import torch
from paper_figures import (
    figure2,
    figure3,
    figure5,
    figure6,
    figure7,
    official,
    painting,
    segmenting,
)
from paper_figures.book import Book, Result, work_through
from paper_figures.story import Table
from paper_figures.subject import Effort, Subject, shown

from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.selection.pick import pick
from stylesplat.stylization.features.weights import load_weights
from stylesplat.training.train_config import TrainConfig
from stylesplat.verbs.load import load

LARGE = CAMERAS.downscale(1 / 4)
EFFORT = Effort(2, 3, 192, whole_grid=False, trained=False, draft=True, judged=2, training_steps=12)


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    photos = load(write_ball_capture(tmp_path_factory.mktemp("capture") / "balls", LARGE))
    red = SceneObject(pick(SPLATS, object_id=3), {"ids": [3]})
    held_out, info = LARGE.names[:2], {"settings": {"max_gaussians": 300, "segment": "joint"}}
    scene = Scene(SPLATS, LARGE, held_out=held_out, objects={"red": red}, info=info)
    style = torch.rand(96, 96, 3, generator=torch.Generator().manual_seed(0))
    styles = {"noise": style, "other": style.flip(-1)}
    return Subject("balls", scene, photos, photos, styles, load_weights("compact", depth=3), EFFORT)


def test_a_scene_against_itself_leaks_nothing(subject: Subject):
    found = figure2.leakage(subject, SPLATS, SPLATS, 3)
    assert found.pop("outside_psnr") == pytest.approx(120)
    assert len(found) == 4 and {*found.values()} == {0}


def test_names_and_the_best_shown_first(subject: Subject):
    assert {*subject.ids} == {3, 7, 300} and subject.called(3) == "red"
    maps = [subject.true_map(LARGE[row]) for row in range(2)]
    best = [max(shown(labels, id) for labels in maps) for id in subject.ids]
    assert best == sorted(best, reverse=True)


def test_the_view_is_one_that_cuts_nothing_off(subject: Subject):
    whole, cut = torch.zeros(2, 20, 20, dtype=torch.long)
    whole[5:15, 5:15], cut[:12, :12], cut[15:17, 15:17] = 1, 1, 2
    other = replace(subject)
    vars(other)["true_maps"] = [cut, whole]
    assert other.best_view(1).names == LARGE.names[1:2]
    assert other.best_view(1, 2).names == LARGE.names[:1], "the other one shows no 2"


def test_what_the_edge_cuts_off_is_shown_worse():
    whole, cut = torch.zeros(20, 20, dtype=torch.long), torch.zeros(20, 20, dtype=torch.long)
    whole[5:15, 5:15], cut[:12, :12] = 1, 1
    assert (shown(whole, 1), shown(cut, 1), shown(cut, 2)) == (100, 144 / 25, 0)


def test_masks_without_error_are_exact_and_more_error_is_more(subject: Subject):
    shares = []
    for level in (0.0, 1.0, 2.0):
        noisy = figure2.with_errors(subject, level).label_maps
        exact = subject.capture.label_maps
        assert noisy is not None and exact is not None
        pairs = zip(noisy, exact, strict=True)
        shares.append(sum(float((a != b).float().mean()) for a, b in pairs if a is not None))
    assert 0 == shares[0] < shares[1] < shares[2]


def test_selection_in_3d_changes_its_gaussians_alone(subject: Subject, tmp_path: Path):
    cells = {cell.key: cell for cell in figure2.cells(subject)}
    keys = ["initial", *(f"{way} at 1" for way in (figure2.MASKED, figure2.STRICT))]
    some = [cells[key] for key in (*keys, f"{figure2.LIFTED} at 1")]
    book = Book(tmp_path, {})
    assert len([*work_through(book, some)]) == 4
    found = book.results(some)["figure2"]
    masked, strict, lifted = (found[cell.key].numbers for cell in some[1:])
    assert lifted["changed_gaussians"] <= int(subject.picked(subject.ids[0]).sum())
    assert masked["changed_gaussians"] > strict["changed_gaussians"] > lifted["changed_gaussians"]
    assert lifted["outside_psnr"] > masked["outside_psnr"]
    said = [block for block in figure2.told({"figure2": found}) if hasattr(block, "text")]
    assert len(said) == 2


def test_only_what_was_learned_is_called_trained(subject: Subject):
    lifted = replace(subject.scene, info={"settings": {"segment": "lift"}})
    for each, count in ((subject, 1), (replace(subject, scene=lifted), 0)):
        for figure in (figure2, figure3):
            assert sum("trained" in cell.key for cell in figure.cells(each)) == count


def test_exact_identities_select_what_is_there(subject: Subject):
    """At a threshold between no and yes; the balls' own label maps are the truth."""
    found = figure3.by_selection(subject, SPLATS, 0.5, remove=False)
    assert found["miou"] > 0.9  # labels go to the likeliest class, a cover to half of a pixel
    outcome = figure3._given(subject)
    assert {**outcome.numbers} == {"miou": 1, "boundary_miou": 1}


def test_together_is_the_two_alone_or_it_is_seen(subject: Subject):
    outcome = figure5._both(subject, "paper")
    assert {*outcome.numbers["differing"].values()} == {0}
    assert outcome.numbers["changed_elsewhere"] == 0
    assert outcome.numbers["rows"] == outcome.numbers["expected_rows"] == len(SPLATS)
    nobody = torch.arange(len(SPLATS))
    one = figure5.Painted(SPLATS, ())
    sh0 = SPLATS.sh0.clone()
    sh0[SPLATS.sh0.shape[0] - 1] += 1e-6
    other = figure5.Painted(replace(SPLATS, sh0=sh0), ())
    last = {1: nobody == len(SPLATS) - 1, 2: nobody == 0}
    assert figure5._differing(one, other, 1, last) == 1
    assert figure5._differing(one, other, 2, last) == 0
    assert figure5._elsewhere(subject, other, {2: last[2]}) == 1


def test_what_follows_what_is_said_as_it_is():
    for values, verdict in (
        ((1, 2, 3), "it grows."),
        ((3, 2, 1), "it shrinks."),
        ((1, 3, 2), "it neither grows nor shrinks throughout."),
    ):
        line = {f"scale {n}": {"stroke": float(value)} for n, value in enumerate(values)}
        said = figure6.follows(line, "scale", "stroke")
        assert said.endswith(verdict) and said.startswith("Stroke length by scale: ")


def grid_numbers(group: int, scale: float, rate: float) -> dict[str, float]:
    """A stroke of 10 times the scale and one more by group, a strength of 100 times the rate."""
    measured = {"stroke": 10 * scale + group, "strength": 100 * rate, "content_ssim": 0.5}
    return {"group": group, "scale": scale, "rate": rate, **measured}


def test_an_axis_is_averaged_over_the_others_or_goes_through_their_middle():
    every = list(product(figure6.GROUPS, figure6.SCALES, figure6.RATES))
    grid = [grid_numbers(*setting) for setting in every]
    whole = figure6.by_axis(grid, "scale", whole=True)
    assert [n["stroke"] for n in whole.values()] == pytest.approx([4.5, 7, 9.5])
    assert list(whole) == ["scale 0.25", "scale 0.5", "scale 0.75"]
    line = figure6.by_axis(grid, "layers", whole=False)
    assert [n["stroke"] for n in line.values()] == pytest.approx([6, 7, 8])
    assert list(line) == ["layers [1,3]", "layers [6,8]", "layers [11,13,15]"]
    rates = figure6.by_axis(grid, "rate", whole=True)
    assert [n["strength"] for n in rates.values()] == pytest.approx([2.5, 5, 7.5])


def test_the_grid_or_the_lines_through_its_middle(subject: Subject):
    assert len(figure6.cells(subject)) == 1 + 7
    whole = replace(subject, effort=replace(EFFORT, whole_grid=True))
    assert len(figure6.cells(whole)) == 1 + 27


def test_a_grid_for_each_group_of_layers_once_all_is_there():
    every = list(product(figure6.GROUPS, figure6.SCALES, figure6.RATES))
    shown = {"object": Path("picture.png")}
    found = {figure6._key(s): Result(grid_numbers(*s), shown, 1.0, 1.0) for s in every}
    grids = figure6._grids(found)
    assert [len(grid.rows) for grid in grids] == [3, 3, 3]
    assert list(grids[0].rows["rate 0.025"]) == ["scale 0.25", "scale 0.5", "scale 0.75"]
    del found[figure6._key((1, 0.25, 0.025))]
    (lines,) = figure6._grids(found)
    assert list(lines.rows) == ["layers", "scale", "rate"]
    assert figure6._grids({figure6._key(every[0]): found[figure6._key(every[1])]}) == []
    assert list(lines.rows["layers"]) == ["[1,3]", "[6,8]", "[11,13,15]"]


def test_of_many_style_features_few_are_matched(monkeypatch: pytest.MonkeyPatch):
    anything: Any = [None] * 4
    every = [torch.arange(9000.0)[:, None], torch.arange(5.0)[:, None]]
    monkeypatch.setattr(painting.optimize, "target_features", lambda *_: every)
    with painting.few_style_features():
        many, few = painting.optimize.target_features(*anything)
    assert len(many.unique()) == painting.optimize.STYLE_FEATURES < 9000 and len(few) == 5
    assert painting.optimize.target_features(*anything) is every


def test_each_way_to_identities_gets_the_time_of_joint_training(
    subject: Subject, monkeypatch: pytest.MonkeyPatch
):
    """With a clock by which a step of joint training takes thrice as long, and lifting 6 steps."""
    monkeypatch.setattr(segmenting, "fitted", _by_the_clock)
    config = segmenting.as_trained(subject)
    assert (config.steps, config.max_gaussians) == (12, 300)
    assert segmenting.affordable(subject, segmenting.WAYS["lifted"], config) == 12 * 3 - 6
    off = segmenting.WAYS["joint, without the 3D term"]
    assert segmenting.affordable(subject, off, config) == 12


def _by_the_clock(_subject: Subject, way: segmenting.Way, config: TrainConfig):
    return SPLATS, config.steps * (1.0 if way.lifted else 3.0), 6.0 * way.lifted


def test_one_thread_for_a_while():
    before = numba.get_num_threads(), torch.get_num_threads()
    with figure7.one_thread():
        assert (numba.get_num_threads(), torch.get_num_threads()) == (1, 1)
    assert (numba.get_num_threads(), torch.get_num_threads()) == before


def test_speed_and_times_are_told_beside_the_papers(subject: Subject):
    trained = replace(subject.scene, metrics={"psnr": 30.0, "ssim": 0.9, "steps": 12})
    speed = figure7._speed(replace(subject, scene=trained)).numbers
    width, height = LARGE.size
    assert f"{width}x{height}" in speed["fps"] and min(speed["fps"].values()) > 0
    painted = {"a, paper": Result({"painting": 7.2}, {}, 1.0, 1.0)}
    found = {"figure7": {"speed": Result(speed, {}, 1.0, 1.0)}, "figure1": painted}
    table, *_ = figure7.told(found)
    assert isinstance(table, Table)
    assert ["painting, a, paper", "7 s of one core", "less than a minute"] in list(table.rows)


def test_joint_and_lifted_are_measured_and_compared(subject: Subject, tmp_path: Path):
    cells = {cell.key: cell for cell in segmenting.cells(subject)}
    book, some = Book(tmp_path, {}), [cells["joint"]]
    assert len([*work_through(book, some)]) == 1
    numbers = book.results(some)["segmenting"]["joint"].numbers
    assert numbers["steps"] == 12 and numbers["by_hand"] is None and numbers["lifting"] >= 0
    better = {**numbers, "psnr": numbers["psnr"] + 1, "miou": numbers["miou"] - 0.25}
    assert "gains +1.00 dB, -0.250 of mIoU" in segmenting._verdict(better, numbers)


def test_without_the_term_in_3d_it_is_left_out(subject: Subject):
    counted = segmenting.step.NEIGHBORS
    with segmenting.Way(neighbours=False).switched():
        assert len(SPLATS) < segmenting.step.NEIGHBORS
    assert counted == segmenting.step.NEIGHBORS < len(SPLATS)


def test_labels_as_brightnesses_make_ids_that_were_not_there():
    labels = torch.zeros(40, 40, dtype=torch.int64)
    labels[:, 17:] = 200
    small = official.bicubic_labels(labels, (30, 20))
    assert small.shape == (20, 30) and small.dtype == labels.dtype
    assert {*small.unique().tolist()} - {0, 200}


def test_a_squashed_style_has_the_proportions_of_the_frame_on_its_side():
    assert official.squashed(torch.rand(50, 50, 3), (32, 18)).shape == (32, 18, 3)


def test_where_black_counts_too_the_object_takes_on_less(subject: Subject, tmp_path: Path):
    cells = [cell for cell in official.cells(subject) if cell.key in ("none", official.BLACK)]
    book = Book(tmp_path, {})
    assert len([*work_through(book, cells)]) == 2
    found = book.results(cells)["official"]
    plain, black = (found[cell.key].numbers for cell in cells)
    assert plain["mask_iou"] == black["mask_iou"] and plain["strength"] != black["strength"]
    assert len(official.told({"official": found})) == 2


def test_the_formula_as_it_is_printed_leads_away_from_the_style(subject: Subject):
    effort = replace(EFFORT, masked_steps=12)
    again = replace(subject, effort=effort)
    numbers = {
        key: official._styled(again, faults).numbers["nnfm"]
        for key, faults in (("none", ()), ("printed", (official.PRINTED,)))
    }
    assert numbers["printed"] > numbers["none"]
