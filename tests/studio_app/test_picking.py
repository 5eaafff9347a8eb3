from dataclasses import replace
from typing import get_args

import pytest
import torch

from balls import CAMERAS, SPLATS, enlarged
from stylesplat.errors import StyleSplatError
from stylesplat.options import PickSize
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.selection.text import clear_winner
from stylesplat.studio_app import selecting
from stylesplat.studio_app.history import ObjectMasks, StudioState, hidden_rows, object_names
from stylesplat.studio_app.messages import How
from stylesplat.studio_app.selecting import (
    feather_picked,
    forget_picked,
    hide_objects,
    invert_picked,
    name_selection,
    pick_ball,
    pick_box,
    pick_drawn,
    pick_names,
    pick_surface,
    pick_words,
    region_of,
    rename_picked,
    resize_picked,
    soft_brush,
    subtract_picked,
    unite_picked,
)

CAMERA = enlarged(CAMERAS, 4)[0]
BALLS = {"3": (-0.7, 0.0, 0.3), "7": (0.7, 0.0, 0.3), "300": (0.0, 0.8, 0.3)}
STATE = StudioState(Scene(SPLATS, CAMERAS))
PLAIN = StudioState(Scene(replace(SPLATS, identities=None, classifier=None), CAMERAS))


def place(name: str) -> tuple[float, float]:
    """In shares of the picture."""
    x, y = project(torch.tensor([BALLS[name]]), CAMERA)[0][0].tolist()
    return x / CAMERA.size[0], y / CAMERA.size[1]


def selected(state: StudioState) -> torch.Tensor:
    assert state.selection is not None
    return state.selection.weights >= 128


def test_a_ball_picks_without_labels_and_strokes_correct_it():
    first = pick_ball(PLAIN, CAMERA, place("3"), 0.25)
    count = int(selected(first).sum())
    assert 0 < count < len(SPLATS) and not first.picked
    more = pick_ball(first, CAMERA, place("7"), 0.25, "add")
    assert int(selected(more).sum()) > count
    less = pick_ball(more, CAMERA, place("7"), 0.25, "away")
    assert torch.equal(selected(less), selected(first))
    shared = pick_ball(more, CAMERA, place("7"), 0.25, "within")
    assert torch.equal(selected(shared), selected(more) & ~selected(first))
    assert not object_names(less.scene), "it has no name"
    named = name_selection(less, "ball")
    assert object_names(named.scene) == ["ball"] == [*named.picked] and named.selection is None
    assert named.scene.objects["ball"].selection.rows, "of two shapes"
    assert name_selection(first, "ball").scene.objects["ball"].selection.sphere
    again = pick_ball(named, CAMERA, place("7"), 0.25, "add")
    assert again.selection is not None and again.selection.origin == "ball"
    with pytest.raises(StyleSplatError, match="enlarge the radius"):
        pick_ball(PLAIN, CAMERA, place("3"), 1e-6)


def test_a_click_picks_on_the_surface_without_labels():
    large = StudioState(replace(PLAIN.scene, cameras=enlarged(CAMERAS, 4)))
    near = (SPLATS.means - torch.tensor(BALLS["3"])).norm(dim=1) < 0.35
    for size in get_args(PickSize):
        state = pick_surface(large, CAMERA, place("3"), size)
        mask = selected(state)
        assert mask[near].sum() > 0.8 * mask.sum() > 0, size
    with pytest.raises(StyleSplatError, match="background, or nothing solid"):
        pick_surface(large, CAMERA, (0.0, 0.0), "object")


def test_what_is_drawn_picks_what_shows_inside_and_corrects_a_pick():
    masks, (x, y), (width, height) = ObjectMasks(), place("3"), CAMERA.size

    def drawn(state: StudioState, left: float, right: float, how: How = "new") -> StudioState:
        points = [(x + left / width, y - 24 / height), (x + right / width, y + 24 / height)]
        return pick_drawn(state, CAMERA, region_of("rectangle", points, CAMERA.size, 0.0), how)

    ball = masks.of(STATE.scene, "3")
    first = drawn(PLAIN, -24, 24)
    whole = selected(first)
    assert int((whole & ball).sum()) > 0.7 * int(ball.sum()), (
        "what shows, and what is close beneath"
    )
    less = drawn(first, 0, 24, "away")
    left = selected(less)
    assert 0 < int(left.sum()) < int(whole.sum())
    again = drawn(less, 0, 24, "add")
    assert int((selected(again) & whole).sum()) > 0.9 * int(whole.sum())
    with pytest.raises(StyleSplatError, match="Nothing is left"):
        drawn(first, -40, 40, "away")
    with pytest.raises(StyleSplatError, match="Nothing shows inside"):
        pick_drawn(PLAIN, CAMERA, torch.zeros(height, width, dtype=torch.bool))


def test_lines_become_regions():
    square = [(0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75)]
    lasso = region_of("lasso", square, (40, 40), 0.0)
    assert lasso[20, 20] and not lasso[5, 5] and 350 < int(lasso.sum()) < 480
    assert not region_of("lasso", square[:2], (40, 40), 0.0).any()
    dot = region_of("brush", [(0.5, 0.5)], (40, 40), 0.1)
    assert dot[20, 20] and not dot[20, 26] and 40 < int(dot.sum()) < 75
    back = region_of("rectangle", [(0.5, 0.5), (0.0, 0.0)], (40, 40), 0.0)
    assert back[:20, :20].all() and not back[22:, 22:].any()


def test_shapes_sizes_differences_and_names():
    masks = ObjectMasks()
    box = pick_box(STATE, (-1.2, -0.5, 0.05), (-0.2, 0.5, 0.8))
    of_ball = masks.of(STATE.scene, "3")
    assert int((selected(box) & of_ball).sum()) > 60
    wide = resize_picked(box, 0.2)
    assert int(selected(wide).sum()) > int(of_ball.sum())
    rest = pick_names(wide, ["3"], "away")
    assert torch.equal(selected(rest), selected(wide) & ~of_ball)
    wide = name_selection(wide, "wide")
    assert torch.equal(selected(subtract_picked(pick_names(wide, ["wide", "3"]))), selected(rest))
    both = unite_picked(pick_names(wide, ["3", "7"]))
    assert torch.equal(selected(both), of_ball | masks.of(STATE.scene, "7"))
    assert torch.equal(selected(invert_picked(both)), ~selected(both))
    soft = feather_picked(both, 0.2)
    assert soft.selection is not None and soft.selection.is_soft
    assert torch.equal(selected(soft), selected(both)), "its border stays where it was"
    assert torch.equal(selected(invert_picked(soft)), ~selected(soft))
    named = rename_picked(pick_names(STATE, ["3"]), "red ball")
    assert named.picked == ("red ball",) and "3" not in object_names(named.scene)
    locked = replace(named, locked=frozenset({"red ball/2", "7"}), solo=("red ball", {"7": True}))
    again = rename_picked(locked, "ball")
    assert again.locked == {"ball/2", "7"} and again.solo == ("ball", {"7": True})
    assert again.picked == ("ball",) and object_names(forget_picked(again).scene) == [
        "3",
        "7",
        "300",
    ]


def test_objects_are_hidden():
    masks, state = ObjectMasks(), pick_names(STATE, ["3"])
    assert hidden_rows(state, masks) is None
    without = hide_objects(state, ["3"], True)
    hidden = hidden_rows(without, masks)
    assert hidden is not None and torch.equal(hidden, masks.of(STATE.scene, "3"))
    assert not without.picked
    assert hidden_rows(hide_objects(without, ["3"], False), masks) is None


@pytest.mark.parametrize(
    "change",
    [
        unite_picked,
        subtract_picked,
        lambda s: resize_picked(s, 0.1),
        lambda s: name_selection(s, "ball"),
        invert_picked,
        forget_picked,
    ],
)
def test_without_a_pick_it_says_what_to_do(change):
    with pytest.raises(StyleSplatError, match=r"[Pp]ick|[Ss]elect"):
        change(STATE)


def test_words_download_no_model_while_all_browsers_wait(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(selecting, "is_at_hand", lambda name: False)
    monkeypatch.setattr(selecting, "resolve_selection", lambda *_, **__: pytest.fail())
    with pytest.raises(StyleSplatError, match="not installed here") as told:
        pick_words(STATE, "red chair")
    assert "pip" not in str(told.value), "whom the page is for may have no terminal"


def test_words_that_fit_nothing_are_told_without_the_command_line(monkeypatch: pytest.MonkeyPatch):
    def resolve(*_: object, **__: object) -> None:
        clear_winner({}, "red chair")

    monkeypatch.setattr(selecting, "is_at_hand", lambda name: True)
    monkeypatch.setattr(selecting, "resolve_selection", resolve)
    with pytest.raises(StyleSplatError, match="fits 'red chair'") as told:
        pick_words(STATE, "red chair")
    assert "--" not in str(told.value)


def test_a_soft_brush_follows_the_line_and_does_not_close_it():
    around = soft_brush([(0.1, 0.1), (0.1, 0.9), (0.9, 0.9)], (100, 100), 0.05, 0.5)
    assert around[50, 10] == around[90, 50] == 1 and around[50, 50] == 0
    point = soft_brush([(0.5, 0.5)], (100, 100), 0.05, 0.5)
    assert point[50, 50] == 1 and 0 < point[50, 54] < 1 and point[50, 56] == 0
