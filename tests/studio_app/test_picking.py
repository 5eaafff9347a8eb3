from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, SPLATS, enlarged
from stylesplat.errors import StyleSplatError
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.history import ObjectMasks, StudioState, display_of, object_names
from stylesplat.studio_app.picking import (
    forget_picked,
    hide_picked,
    isolate_picked,
    object_in,
    pick_at,
    pick_ball,
    pick_box,
    pick_names,
    pick_round,
    pick_words,
    rename_picked,
    resize_picked,
    subtract_picked,
    unite_picked,
)

CAMERA = enlarged(CAMERAS, 4)[0]
BALLS = {"3": (-0.7, 0.0, 0.3), "7": (0.7, 0.0, 0.3), "300": (0.0, 0.8, 0.3)}
STATE = StudioState(Scene(SPLATS, CAMERAS))
PLAIN = StudioState(Scene(replace(SPLATS, identities=None, classifier=None), CAMERAS))


def pixel(name: str) -> tuple[float, float]:
    x, y = project(torch.tensor([BALLS[name]]), CAMERA)[0][0].tolist()
    return x, y


@pytest.mark.parametrize("name", BALLS)
def test_a_click_picks_the_object_that_shows_there(name: str):
    state = pick_at(STATE, ObjectMasks(), CAMERA, pixel(name))
    assert state.picked == (name,) and state.scene is STATE.scene


def test_clicks_add_take_away_and_beside_everything_pick_nothing():
    masks = ObjectMasks()
    one = pick_at(STATE, masks, CAMERA, pixel("3"))
    both = pick_at(one, masks, CAMERA, pixel("7"), "add")
    assert both.picked == ("3", "7")
    assert pick_at(both, masks, CAMERA, pixel("3"), "away").picked == ("7",)
    assert pick_at(both, masks, CAMERA, (1.0, 1.0)).picked == ()
    assert pick_at(both, masks, CAMERA, (1.0, 1.0), "add") is both


def test_a_rectangle_picks_what_shows_most_in_it_but_not_what_is_hidden():
    (x0, y0), (x1, y1) = pixel("3"), pixel("7")
    low, high = (x0 - 30, y0 - 30), ((x0 + x1) / 2 - 10, y1 + 30)
    assert object_in(STATE, ObjectMasks(), CAMERA, low, high) == "3"
    without = hide_picked(pick_names(STATE, ["3"]), True)
    assert object_in(without, ObjectMasks(), CAMERA, low, high) != "3"


def test_of_names_that_show_alike_a_click_picks_the_smallest():
    both = unite_picked(pick_names(STATE, ["3", "7"]))
    assert both.picked == ("pick 1",)
    assert pick_at(both, ObjectMasks(), CAMERA, pixel("3")).picked == ("3",)


def test_a_ball_picks_without_labels_and_strokes_correct_it():
    masks = ObjectMasks()
    first = pick_ball(PLAIN, CAMERA, pixel("3"), 0.25)
    assert first.picked == ("pick 1",)
    count = int(masks.of(first.scene, "pick 1").sum())
    assert 0 < count < len(SPLATS)
    more = pick_ball(first, CAMERA, pixel("7"), 0.25, "add")
    assert more.picked == ("pick 1",) and int(masks.of(more.scene, "pick 1").sum()) > count
    less = pick_ball(more, CAMERA, pixel("7"), 0.25, "away")
    assert torch.equal(masks.of(less.scene, "pick 1"), masks.of(first.scene, "pick 1"))
    assert object_names(less.scene) == ["pick 1"], "what was taken away has no name any more"


def test_a_rectangle_corrects_a_pick_by_the_ball_that_fits_into_it():
    masks, (x, y) = ObjectMasks(), pixel("3")
    first = pick_round(PLAIN, CAMERA, (x - 60, y - 60), (x + 60, y + 60))
    part = pick_round(PLAIN, CAMERA, (x - 60, y - 25), (x + 60, y + 25))
    whole, some = (masks.of(state.scene, "pick 1") for state in (first, part))
    assert 0 < int(some.sum()) < int(whole.sum()) and (whole | ~some).all()
    less = pick_round(first, CAMERA, (x - 60, y - 25), (x + 60, y + 25), "away")
    assert torch.equal(masks.of(less.scene, "pick 1"), whole & ~some)
    places, _ = project(SPLATS.means[some], CAMERA)
    assert (places - torch.tensor([x, y])).abs().max() < 28, "25 pixels, on the near side"


def test_shapes_sizes_differences_and_names():
    masks = ObjectMasks()
    box = pick_box(STATE, (-1.2, -0.5, 0.05), (-0.2, 0.5, 0.8))
    of_ball = masks.of(STATE.scene, "3")
    assert int((masks.of(box.scene, "pick 1") & of_ball).sum()) > 60
    wide = resize_picked(box, 0.2)
    assert int(masks.of(wide.scene, "pick 1").sum()) > int(of_ball.sum())
    rest = subtract_picked(pick_names(wide, ["pick 1", "3"]))
    assert not (masks.of(rest.scene, rest.picked[0]) & of_ball).any()
    named = rename_picked(pick_names(STATE, ["3"]), "red ball")
    assert named.picked == ("red ball",) and "3" not in object_names(named.scene)
    again = rename_picked(named, "ball")
    assert again.picked == ("ball",) and object_names(forget_picked(again).scene) == [
        "3",
        "7",
        "300",
    ]


def test_what_is_picked_glows_and_is_shown_alone_or_not_at_all():
    masks, state = ObjectMasks(), pick_names(STATE, ["3"])
    red = masks.of(STATE.scene, "3")
    seen = display_of(state, masks)
    changed = (seen.visible.sh0 != SPLATS.sh0).flatten(1).any(dim=1)
    assert torch.equal(changed, red), "these and no others"
    assert seen.splats is state.scene.splats, "the scene stays as it is"
    assert len(display_of(isolate_picked(state, True), masks).visible) == int(red.sum())
    without = display_of(hide_picked(state, True), masks)
    assert len(without.visible) == int((~red).sum())
    assert len(display_of(hide_picked(state, False), masks).visible) == len(SPLATS)


@pytest.mark.parametrize(
    "change", [unite_picked, subtract_picked, lambda s: resize_picked(s, 0.1), forget_picked]
)
def test_without_a_pick_it_says_what_to_do(change):
    with pytest.raises(StyleSplatError, match=r"[Pp]ick"):
        change(STATE)


def test_commands_name_the_same_gaussians(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    import shlex

    from processes import run
    from stylesplat.io.scene_folder import open, save
    from stylesplat.studio_app.save_panel import command_lines

    save(PLAIN.scene, tmp_path / "balls")
    state = StudioState(open(tmp_path / "balls"))
    state = pick_ball(state, CAMERA, pixel("3"), 0.3)
    state = pick_ball(state, CAMERA, pixel("300"), 0.3, "add")
    state = pick_ball(state, CAMERA, pixel("3"), 0.2, "away")
    for line in command_lines(state, tmp_path / "balls", tmp_path / "out") or ():
        assert run(*shlex.split(line)[1:]) == 0, line
    found = open(tmp_path / "balls").objects
    assert found.keys() == {"pick 1"}
    assert torch.equal(found["pick 1"].picked, state.scene.objects["pick 1"].picked)


def test_words_download_no_model_while_all_browsers_wait(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("stylesplat.studio_app.picking.is_at_hand", lambda name: False)
    monkeypatch.setattr("stylesplat.studio_app.picking.select", lambda *_, **__: pytest.fail())
    with pytest.raises(StyleSplatError, match=r"pip install .*hf download IDEA-Research/"):
        pick_words(STATE, "red chair")
