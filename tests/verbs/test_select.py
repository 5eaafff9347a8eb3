from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS
from color_detector import ColorDetector
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.photos import read_image
from stylesplat.io.scene_folder import Scene, read_scene, write_scene
from stylesplat.selection.identities import render_labels
from stylesplat.selection.pick import pick
from stylesplat.verbs import select as verb
from stylesplat.verbs.objects import list_objects
from stylesplat.verbs.select import Choice, select_object

VIEW = CAMERAS.names[2]


def place(id: int) -> tuple[str, tuple[float, float]]:
    """The middle of a ball in a view."""
    labels = render_labels(SPLATS, CAMERAS[2])
    y, x = (labels == id).nonzero().median(dim=0).values.tolist()
    return VIEW, (float(x), float(y))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write_scene(Scene(SPLATS, CAMERAS), tmp_path / "scene")
    return tmp_path / "scene"


def test_several_points_are_united(scene: Path):
    found = select_object(scene, "two", Choice(points=(place(3), place(7))))
    assert found["ids"] == [3, 7]


def test_a_point_that_is_not_meant(scene: Path):
    found = select_object(scene, "some", Choice(ids=(3, 7, 300), not_points=(place(7),)))
    assert found["ids"] == [3, 300]
    with pytest.raises(StyleSplatError, match="--not-point only takes away"):
        select_object(scene, "none", Choice(ids=(7,), not_points=(place(7),)))
    around = Choice(box3d=(-3.0, -3.0, 0.02, 3.0, 3.0, 3.0), not_points=(place(7),))
    select_object(scene, "all but green", around)
    green = pick(SPLATS, object_id=7)
    assert not (read_scene(scene).picks["all but green"] & green).any()


def test_union_and_difference_of_earlier_selections(scene: Path):
    for id, name in ((3, "red"), (7, "green")):
        select_object(scene, name, Choice(ids=(id,)))
    select_object(scene, "both", Choice(plus=("red", "green")))
    select_object(scene, "rest", Choice(plus=("both",), minus=("red",)))
    picks = read_scene(scene).picks
    assert torch.equal(picks["both"], picks["red"] | picks["green"])
    assert torch.equal(picks["rest"], picks["green"])
    with pytest.raises(StyleSplatError, match="Nothing is left of 'none'"):
        select_object(scene, "none", Choice(plus=("red",), minus=("both",)))
    with pytest.raises(StyleSplatError, match="no object 'blue'"):
        select_object(scene, "x", Choice(plus=("blue",)))


def test_sphere_around_what_a_pixel_shows(scene: Path):
    view, (x, y) = place(3)
    found = select_object(scene, "ball", Choice(sphere=(view, (x, y, 0.65))))
    mask = read_scene(scene).picks["ball"]
    inside = (SPLATS.means - torch.tensor(BALLS[3][0])).norm(dim=1) < 0.31
    assert (mask & inside).sum() > 0.8 * inside.sum()
    assert found["sphere"][0] == view


def test_grow_and_shrink_come_last(scene: Path):
    whole = select_object(scene, "two", Choice(ids=(3, 7)))
    half = Choice(ids=(3, 7), not_points=(place(7),), grow=0.2)
    more = select_object(scene, "more", half)
    assert more["grow"] == 0.2 and "shrink" not in more
    picks = read_scene(scene).picks
    red, green = (pick(SPLATS, object_id=id) for id in (3, 7))
    assert picks["more"][red].all() and not picks["more"][green].any(), "what was taken stays away"
    assert picks["more"].sum() > red.sum(), "the table under it is taken in"
    less = select_object(scene, "less", Choice(plus=("more",), shrink=0.05))
    assert less["shrink"] == 0.05
    assert 0 < less["gaussians"] < more["gaussians"] < whole["gaussians"]
    assert read_scene(scene).objects["less"]["shrink"] == 0.05


def test_a_grown_name_is_not_the_object(scene: Path):
    select_object(scene, "red", Choice(ids=(3,)))
    select_object(scene, "more", Choice(ids=(3,), grow=0.1))
    select_object(scene, "less", Choice(ids=(3,), shrink=0.01))
    names = {each["id"]: each["names"] for each in list_objects(scene)["objects"]}
    assert names[3] == ["red"]


def test_grow_or_shrink_that_cannot_be(scene: Path):
    with pytest.raises(StyleSplatError, match="Pass --grow or --shrink"):
        select_object(scene, "x", Choice(ids=(3,), grow=0.1, shrink=0.1))
    for share in (0.0, float("nan"), 2.0):
        with pytest.raises(StyleSplatError, match="at most 1"):
            select_object(scene, "x", Choice(ids=(3,), grow=share))
    with pytest.raises(StyleSplatError, match="Shrink it less"):
        select_object(scene, "x", Choice(ids=(3,), shrink=1.0))
    assert not read_scene(scene).picks


def test_a_picture_of_it(scene: Path):
    found = select_object(scene, "red", Choice(ids=(3,)))
    assert found["picture"] == scene / "selections" / "red.png"
    before = read_image(found["picture"])
    assert "picture" not in read_scene(scene).objects["red"]
    select_object(scene, "red", Choice(ids=(7,)))
    assert (read_image(found["picture"]) != before).any(), "it shows the last one of that name"


def test_no_two_names_share_a_picture(scene: Path):
    names = ["vase", "Vase", "a/b", "a-b", "../a", ".", "..", "花瓶", "花", "x" * 300, "x" * 301]
    pictures = [select_object(scene, name, Choice(ids=(3,)))["picture"] for name in names]
    assert len({str(path).lower() for path in pictures}) == len(names)
    assert {path.parent for path in pictures} == {scene / "selections"}
    assert sorted(pictures) == sorted((scene / "selections").iterdir())
    assert read_scene(scene).picks.keys() == set(names)


def test_what_shows_in_no_view_has_no_picture(scene: Path, said: list[str]):
    shown = select_object(scene, "red", Choice(ids=(3,)))
    below = SPLATS.means.clone()
    below[200:280] = torch.tensor([0.0, 0.0, 60.0])  # the red ball, above all cameras
    write_scene(Scene(replace(SPLATS, means=below), CAMERAS), scene / "other")
    (scene / "other" / "selections").mkdir()
    old = scene / "other" / "selections" / "red.png"
    old.write_bytes(shown["picture"].read_bytes())
    found = select_object(scene / "other", "red", Choice(ids=(3,)))
    assert found["picture"] is None and found["gaussians"] == 80
    assert not old.exists(), "the picture of an earlier choice would be wrong"
    assert "red shows in none of the views" in "\n".join(said)


def test_nothing_said(scene: Path):
    with pytest.raises(StyleSplatError, match="Say what with --id, --point"):
        select_object(scene, "x", Choice())


@pytest.fixture
def detector(monkeypatch: pytest.MonkeyPatch) -> ColorDetector:
    detector = ColorDetector()
    monkeypatch.setattr(verb, "load_detector", lambda model, device: detector)
    return detector


def test_by_text(scene: Path, detector: ColorDetector):
    found = select_object(scene, "it", Choice(text="the red one"))
    assert found["ids"] == [3] and found["text"] == "the red one"
    assert found["scores"].keys() == {3} and 0.5 < found["scores"][3] < 0.81
    assert torch.equal(read_scene(scene).picks["it"], pick(SPLATS, object_id=3))
    assert read_scene(scene).objects["it"]["text"] == "the red one"


def test_text_is_united_with_the_rest(scene: Path, detector: ColorDetector):
    assert select_object(scene, "two", Choice(ids=(7,), text="red"))["ids"] == [7, 3]
    assert select_object(scene, "one", Choice(ids=(3,), text="red"))["ids"] == [3]
    select_object(scene, "red", Choice(ids=(3,)))
    select_object(scene, "green", Choice(ids=(3, 7), text="green", minus=("red",)))
    assert torch.equal(read_scene(scene).picks["green"], pick(SPLATS, object_id=7))


def test_text_that_means_several(scene: Path, detector: ColorDetector):
    with pytest.raises(StyleSplatError, match=r"may mean several objects.* 3 \(0.*--id"):
        select_object(scene, "it", Choice(text="red or green"))
    assert read_scene(scene).picks == {}
    found = select_object(scene, "it", Choice(text="red or green", not_points=(place(7),)))
    assert found["ids"] == [3] and found["scores"].keys() == {3}


def test_text_that_means_nothing(scene: Path, detector: ColorDetector):
    with pytest.raises(StyleSplatError, match="No object of the scene fits 'owl'"):
        select_object(scene, "it", Choice(text="owl"))
    with pytest.raises(StyleSplatError, match="The text is empty"):
        select_object(scene, "it", Choice(text=" "))


def test_text_is_about_how_things_looked_before_styling(tmp_path: Path, detector: ColorDetector):
    """A red ball that was painted green is still the red one."""
    colors = {name: getattr(SPLATS, name) for name in ("sh0", "shN")}
    painted = SPLATS.sh0.clone()
    assert SPLATS.identities is not None
    red, green = (SPLATS.identities[:, column] == 1 for column in (1, 2))
    painted[red], painted[green] = SPLATS.sh0[green], SPLATS.sh0[red]
    styled = Scene(replace(SPLATS, sh0=painted), CAMERAS, base_colors=colors, style_colors=colors)
    write_scene(styled, tmp_path / "styled")
    assert select_object(tmp_path / "styled", "it", Choice(text="red"))["ids"] == [3]


def test_text_needs_objects(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(verb, "load_detector", lambda *_: pytest.fail("it is not needed"))
    write_scene(Scene(replace(SPLATS, identities=None, classifier=None), CAMERAS), tmp_path / "s")
    with pytest.raises(StyleSplatError, match="no identities"):
        select_object(tmp_path / "s", "it", Choice(text="red"))
