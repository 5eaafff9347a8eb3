"""What the page asks for, what comes of it, and what the page is told: without a browser."""

import io
import json
import shlex
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from zlib import decompress

import msgspec
import numpy as np
import pytest
import torch
from PIL import Image

from balls import CAMERAS as EIGHT
from balls import SPLATS, enlarged
from browser import QUICK, stripes, until
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.scene_folder import open, save
from stylesplat.io.style_pictures import MATERIALS
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.selection.resolve import find_object
from stylesplat.studio_app import messages as m
from stylesplat.studio_app.actions import Actions
from stylesplat.studio_app.edits import recolor_objects
from stylesplat.studio_app.gallery import Files
from stylesplat.studio_app.pictures import camera_of
from stylesplat.studio_app.selecting import pick_names
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.studio import StudioServer, studio
from stylesplat.studio_app.thumbnails import SELECTION, ObjectThumbnails
from stylesplat.studio_app.variants import Variants
from stylesplat.studio_app.views import KeptViews
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Style
from stylesplat.verbs.stylize import stylize

CAMERAS = EIGHT[::2]  # all around
CAMERA = enlarged(CAMERAS, 4)[0]
WIDTH, HEIGHT = CAMERA.size

pytestmark = pytest.mark.usefixtures("quick_painting")


class Page:
    """A page without a browser."""

    def __init__(self, opened: StudioServer) -> None:
        self.opened, self.session = opened, opened.session
        self.actions: Actions = opened.server.actions
        self.said, self.files = list[str](), dict[str, bytes]()
        self.flights = list[m.Flight]()
        self.pictures = dict[str, tuple[dict[str, Any], bytes]]()
        self.session.on_message.append(lambda line, *_: self.said.append(line))
        self.session.on_send.append(lambda client, kind, message: self._receive(message))

    def _receive(self, content: bytes | m.Download | m.Flight) -> None:
        if isinstance(content, m.Flight):
            self.flights.append(content)
            return
        if isinstance(content, m.Download):
            found = self.actions.gallery.files.get(content.url.split("/")[2])
            assert found is not None
            self.files[found[0]] = found[1]
            return
        length = int.from_bytes(content[:4], "little")
        header = json.loads(content[4 : 4 + length])
        self.pictures[header.get("which", header["kind"])] = header, content[4 + length :]

    def act(self, what: str, **fields: Any) -> m.StateMessage:
        """Ask as the page does, and wait until it is done."""
        text = msgspec.json.encode({"do": what, **fields})
        message = self.actions.decoder.decode(text)
        if isinstance(message, m.ViewRequest):
            self.actions.pictures.look(1, message)
        else:
            self.actions.act(1, message, lambda: None)
        assert self.session.worker.wait_until_idle()
        return self.actions.state_message()

    def look(self, number: int = 1, **options: Any) -> None:
        viewmat = CAMERA.viewmats[0].flatten().tolist()
        focal = float(CAMERA.Ks[0, 0, 0])
        size = [WIDTH, HEIGHT]
        self.act("look", number=number, viewmat=viewmat, focal=focal, size=size, **options)

    def names(self) -> list[str]:
        return [each.name for each in self.actions.state_message().objects if each.picked]


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    save(Scene(SPLATS, CAMERAS), tmp_path / "balls")
    (tmp_path / "styles").mkdir()
    for name, picture in (("stripes", stripes()), ("turned", stripes().transpose(0, 1).flip(2))):
        Image.fromarray(to_uint8(picture).numpy()).save(tmp_path / "styles" / f"{name}.png")
    styles = tmp_path / "styles"
    opened = studio(tmp_path / "balls", styles=styles, port=0, block=False, device="cpu")
    found = Page(opened)
    found.look()
    yield found
    opened.close()


def place(name: str) -> tuple[float, float]:
    centre = {"3": (-0.7, 0.0, 0.3), "7": (0.7, 0.0, 0.3)}[name]
    x, y = project(torch.tensor([centre]), CAMERA)[0][0].tolist()
    return x / WIDTH, y / HEIGHT


def test_the_pages_camera_is_ours(page: Page):
    look = page.actions.pictures.looks[1]
    assert torch.allclose(camera_of(look).viewmats, CAMERA.viewmats)
    large = camera_of(msgspec.structs.replace(look, size=(3840, 2160)))
    assert large.size == (960, 540)
    hello = page.actions.hello("balls")
    assert np.allclose(hello.start["position"], CAMERAS.positions[0]) and len(hello.photos) == 4
    photo = hello.photos[2]
    ahead = np.subtract(photo["target"], photo["position"])
    assert np.allclose(ahead / np.linalg.norm(ahead), CAMERAS.viewmats[2, 2, :3], atol=1e-5)


def test_a_map_tells_what_a_click_takes_and_how_far_away_it_is(page: Page):
    header, content = page.pictures["map"]
    wide, high = header["size"]
    content = decompress(content)
    ids = np.frombuffer(content[: wide * high], np.uint8).reshape(high, wide)
    depths = np.frombuffer(content[wide * high :], np.float16).reshape(high, wide)
    for name in ("3", "7"):
        x, y = place(name)
        row, column = int(y * high), int(x * wide)
        assert header["names"][ids[row, column] - 1] == name
        assert 2.5 < depths[row, column] < 3.5
    assert ids[0, 0] == 0 and depths[0, 0] == 0
    page.act("pick_names", names=["3"])
    header, content = page.pictures["picked"]
    shares = np.frombuffer(decompress(content), np.uint8).reshape(high, wide)
    number = page.pictures["map"][0]["names"].index("3") + 1
    assert ((shares > 128) == (ids == number)).mean() > 0.97


def test_picks(page: Page):
    page.act("pick_names", names=["3"])
    page.act("pick_names", names=["7"], how="add")
    assert page.names() == ["3", "7"]
    page.act("pick_names", names=["3"], how="away")
    assert page.names() == ["7"]
    page.act("pick_drawn", points=[place("7")], shape="brush", radius=0.05)
    assert page.names() == [] and not page.session.state.scene.objects, "it has no name"
    glow = page.pictures["picked"][1]
    state = page.act("pick_at", place=place("3"), how="add", radius=0.3)
    assert page.pictures["picked"][1] != glow and state.selection is not None
    assert state.undo == "Added to the selection" and state.selection.count > 40
    page.act("name_selection", name="both")
    assert page.names() == ["both"] and page.actions.state_message().selection is None
    page.act("pick_at", place=place("7"), reach=1.0)
    state, selection = page.session.state, page.session.state.selection
    assert selection is not None
    found, ball = selection.weights >= 128, find_object(state.scene, "7")
    assert (found & ball).sum() > 0.9 * found.sum() > 30, "of the ball that was clicked"
    page.act("pick_names", names=[])
    assert page.act("pick_box", low=(-1.2, -0.5, 0.05), high=(-0.2, 0.5, 0.8)).selection
    for share in (0.05, -0.05):
        page.act("resize_picked", share=share)
    state = page.act("feather_picked", share=0.2)
    assert state.selection is not None and state.selection.soft
    page.act("invert_picked")
    page.act("pick_names", names=[])
    assert page.names() == [] and not page.said and [*page.session.state.scene.objects] == ["both"]
    page.act("unite_picked")
    assert "Nothing is picked" in page.said[-1]
    page.act("pick_names", names=["3"])
    page.act("step", rows=-1)
    assert page.act("pick_names", names=[]).redo == "Picked 3", "nothing more is picked than before"


def painted(page: Page, *names: str, style: int = 0) -> m.StateMessage:
    """Paint in fewer steps than the page may ask for."""
    picture = [*page.actions.gallery.pictures.values()][style]
    own = Style(picture.path, config=QUICK)
    page.session.ask(lambda: page.actions.queue.paint(names, own, picture.title))
    assert page.session.worker.wait_until_idle()
    return page.actions.state_message()


def test_layers_have_strength_form_order_and_locks(page: Page):
    before = page.session.state.scene
    state = painted(page, "3", "7")
    assert [each.object for each in state.layers] == ["3", "7"] and state.unsaved
    assert state.layers[0].title == "stripes"
    assert state.layers[0].settings.startswith("quality draft, steps 4")
    first = page.session.state.scene.splats
    state = page.act("move_layer", name="3", to=1)
    assert [each.object for each in state.layers] == ["7", "3"] and "up" in state.undo
    assert page.act("move_layer", name="3", to=5).undo == state.undo, "it is on top"
    page.act("step", rows=-1)
    assert torch.equal(page.session.state.scene.splats.sh0, first.sh0)
    assert not page.act("set_visible", name="3", visible=False).layers[0].visible
    seven = page.session.masks.of(page.session.state.scene, "7")
    assert torch.equal(page.session.state.scene.splats.sh0[~seven], before.splats.sh0[~seven])
    page.act("set_visible", name="3", visible=True)
    assert page.act("adjust_layer", name="3", strength=0.5).layers[0].strength == 0.5
    assert page.act("adjust_layer", name="7", form=0.2).layers[1].form == 0.2
    page.act("set_locked", name="3", locked=True)
    for what, fields in (
        ("adjust_layer", {"strength": 1.0}),
        ("remove_paint", {}),
    ):
        page.act(what, name="3", **fields)
        assert "locked" in page.said.pop()
    painted(page, "3")
    assert "locked" in page.said.pop()
    page.act("set_locked", name="3", locked=False)
    page.act("remove_paint", name="3")
    state = page.act("remove_paint", name="7")
    assert not state.layers and torch.equal(page.session.state.scene.splats.sh0, before.splats.sh0)
    page.act("adjust_layer", name="3", strength=0.3)
    assert "not painted" in page.said[-1]


def test_an_object_has_several_layers_with_blends_masks_and_settings_of_others(page: Page):
    """Undo of each is one step, to the bit."""
    painted(page, "3")
    state = painted(page, "3/2", style=1)
    assert [each.name for each in state.layers] == ["3", "3/2"]
    assert page.session.state.scene.painted_objects == ("3",)
    (x, y), session = place("3"), page.session

    def changes(what: str, **fields: Any) -> m.StateMessage:
        before = session.state
        state = page.act(what, **fields)
        after = session.state
        assert after.scene.splats is not before.scene.splats, page.said
        page.act("step", rows=-1)
        for name, tensor in session.state.scene.splats.tensors().items():
            assert torch.equal(tensor, before.scene.splats.tensors()[name]), (what, name)
        page.act("step", rows=1)
        assert torch.equal(session.state.scene.splats.sh0, after.scene.splats.sh0)
        return state

    state = changes("set_blend", name="3/2", blend="luminosity")
    assert state.layers[1].blend == "luminosity" and "luminosity" in state.undo
    line = [(x - 0.05, y), (x + 0.05, y)]
    state = changes("mask_drawn", name="3/2", points=line, shows=False, radius=0.04)
    assert state.layers[1].masked and not state.layers[0].masked
    mask = session.state.scene.layers[1].mask
    assert mask is not None and mask.min() < 0.5 and mask.max() > 0.9
    changes("mask_drawn", name="3/2", points=line, shows=True, radius=0.03)
    page.act("mask_drawn", name="3/2", points=[(0, 0)], shows=False, radius=0.01)
    assert "did not touch" in page.said.pop()
    state = changes("remove_mask", name="3/2")
    assert not state.layers[1].masked
    page.act("mask_by_selection", name="3")
    assert "Nothing is selected" in page.said.pop()
    page.act("pick_drawn", points=[(x - 0.03, y), (x + 0.03, y)], shape="brush", radius=0.03)
    assert changes("mask_by_selection", name="3").layers[0].masked
    state = changes("solo_layer", name="3/2")
    assert [each.visible for each in state.layers] == [False, True] and state.layers[1].solo
    state = changes("solo_layer", name="3/2")
    assert [each.visible for each in state.layers] == [True, True] and not page.said
    page.act("solo_layer", name="3/2")
    state = page.act("save")
    assert not any(each.solo for each in state.layers) and "Saved" in page.said.pop()
    assert all(each.visible for each in open(session.folder).layers), "alone is to look at"
    first = session.state.scene.layers[0].sh0
    state = page.act("repaint_layer", name="3", settings={"scale": 1.0})
    assert state.layers[0].values["scale"] == 1.0 and state.layers[0].masked
    assert not torch.equal(session.state.scene.layers[0].sh0, first)
    state = page.act("copy_settings", name="3/2", source="3")
    assert state.layers[1].values["scale"] == 1.0 and state.layers[1].title == "turned"
    assert state.layers[1].blend == "normal", page.said
    page.act("step", rows=-1)
    assert page.actions.state_message().layers[1].blend == "luminosity", "in one step"


def test_what_is_removed_or_mended_is_a_layer_that_a_recipe_repeats(page: Page, tmp_path: Path):
    session, (x, y) = page.session, place("7")
    before = session.state.scene
    page.act("pick_at", place=place("3"), tolerance=0.15)
    selection = session.state.selection
    assert selection is not None
    ball = find_object(before, "3")
    assert (selection.weights[ball] > 0).float().mean() > 0.5
    assert (selection.weights[find_object(before, "7")] > 0).sum() == 0
    for what, values in (("size", before.base.scales.amax(1)), ("opacity", -before.base.opacities)):
        state = page.act("pick_extreme", by=what, share=0.1)
        assert state.selection is not None and state.selection.count == 44
        assert session.state.selection is not None
        chosen = session.state.selection.weights > 0
        assert values[chosen].min() >= values[~chosen].max()
    page.act("pick_extreme", by="distance", share=0.1)
    state = page.act("pick_extreme", by="distance", share=0.05)
    assert state.undo == "Selected" and state.selection is not None
    assert state.selection.count == 22
    state = page.act("step", rows=-1)
    assert state.undo == "Selected" and state.selection is not None, "the one before"
    page.act("pick_extreme", by="size", share=0.1)
    assert page.act("pick_extreme", by="size", share=0.0).selection is None
    page.act("pick_names", names=["3"])
    state = page.act("remove_picked")
    assert [each.name for each in state.layers] == ["3/removed"] and not state.selection
    assert (session.state.scene.splats.opacities[ball] < -15).all()
    assert torch.equal(session.state.scene.splats.opacities[~ball], before.splats.opacities[~ball])
    page.act("mend_drawn", points=[(x, y)], radius=0.05)
    state = page.act("mend_drawn", points=[(x + 0.03, y)], radius=0.05)
    assert [each.title for each in state.layers] == ["removed", "mended"], page.said
    mended = session.state.scene.splats
    assert not torch.equal(mended.sh0, before.splats.sh0)
    page.act("recolor", names=["7"], setting="hue", value=50)
    page.act("save")
    saved = open(session.folder)
    assert torch.equal(saved.splats.sh0, session.state.scene.splats.sh0)
    recipe = read_recipe(session.folder / "recipe.json")
    again = stylize(before, recipe, device="cpu", measured=False)
    assert [each.name for each in again.layers] == ["3/removed", "mending/mended", "7/recolor"]
    for name, tensor in saved.splats.tensors().items():
        assert torch.equal(tensor, again.splats.tensors()[name]), name
    for name in ("7/recolor", "mending/mended", "3/removed"):
        page.act("remove_paint", name=name)
    assert torch.equal(session.state.scene.splats.opacities, before.splats.opacities)
    assert torch.equal(session.state.scene.splats.sh0, before.splats.sh0) and not page.said[1:]


def test_a_selection_becomes_an_object_by_paint_which_fades_with_its_border(page: Page):
    """In one step of undo, to the bit; a selection that cannot be painted stays one."""
    before = page.session.state.scene
    page.act("pick_names", names=["3"])
    page.act("feather_picked", share=0.3)
    selection = page.session.state.selection
    assert selection is not None and selection.is_soft
    own = Style(next(iter(page.actions.gallery.pictures.values())).path, config=QUICK)
    page.session.ask(lambda: page.actions.queue.paint_selection(own, "stripes"))
    assert page.session.worker.wait_until_idle()
    (layer,) = page.session.state.scene.layers
    assert layer.object == "painted part" and page.names() == ["painted part"]
    assert layer.mask is not None
    assert torch.equal(layer.mask, (selection.weights / 255)[layer.rows])
    page.act("step", rows=-1)
    assert page.session.state.scene.splats is before.splats
    assert page.session.state.selection is selection and not page.session.state.scene.objects
    state = page.act("recolor", names=[], setting="hue", value=90)
    assert [each.name for each in state.layers] == ["recoloured part/recolor"]
    mask = page.session.state.scene.layers[0].mask
    assert mask is not None and 0 < mask.min() < mask.max() == 1
    page.act("recolor", names=[], setting="hue", value=120)  # before the page knows the object
    page.act("recolor", names=["recoloured part"], setting="hue", value=150)
    page.act("step", rows=-1)  # the drag is one step, and a selection before it
    assert page.session.state.selection is selection and not page.session.state.scene.layers
    page.act("pick_names", names=["7"])
    page.act("resize_picked", share=0.01)

    def queue_both() -> None:
        page.actions.queue.paint(["3"], own, "stripes")
        page.actions.queue.paint_selection(own, "stripes")

    page.session.ask(queue_both)
    assert page.session.worker.wait_until_idle()
    names = [each.name for each in page.session.state.scene.layers]
    assert names == ["3", "painted part"], "it waited for its turn"
    page.act("step", rows=-2)
    page.act("pick_drawn", points=[place("7")], shape="brush", radius=0.02)
    page.session.ask(lambda: page.actions.queue.paint_selection(own, "stripes"))
    assert page.session.worker.wait_until_idle()
    assert "too few for a texture" in page.said[-1] and not page.session.state.scene.objects
    assert page.session.state.selection is not None


def test_colours_change_at_once_and_undo_names_them(page: Page):
    before = page.session.state.scene.splats
    mask = find_object(page.session.state.scene, "3")
    for hue in (40, 80, 120):
        state = page.act("recolor", names=["3"], setting="hue", value=hue)
    assert state.undo == "Recoloured 3: hue 120"
    (layer,) = state.layers
    assert (layer.name, layer.object, layer.title) == ("3/recolor", "3", "recoloured")
    assert layer.recolor == {"hue": 120.0, "match": ""}
    now = page.session.state.scene.splats
    assert not torch.equal(now.sh0[mask], before.sh0[mask])
    assert torch.equal(now.sh0[~mask], before.sh0[~mask])
    state = page.act("recolor", names=["3"], setting="match", value="turned")
    assert state.layers[0].recolor == {"hue": 120.0, "match": "turned"}
    assert page.act("adjust_layer", name="3/recolor", strength=0.5).layers[0].strength == 0.5
    page.act("recolor", names=["3"], setting="tint", value="teal")
    assert page.session.state.scene.layers[0].strength == 0.5
    page.act("recolor", names=["3"], setting="tint", value=None)
    page.act("recolor", names=["3"], setting="match", value=None)
    state = page.act("recolor", names=["3"], setting="swap", value=["#c02020=#2020c0"])
    assert state.layers[0].recolor == {"hue": 120.0, "swap": ("#c02020=#2020c0",), "match": ""}
    page.act("recolor", names=["3"], setting="swap", value=[])
    assert not page.act("recolor", names=["3"], setting="hue", value=0).layers
    assert torch.equal(page.session.state.scene.splats.sh0, before.sh0)
    page.act("step", rows=-6)
    assert page.act("step", rows=-1).undo == "", "a drag is one step"
    page.act("recolor", names=["background"], setting="saturation", value=0)
    assert page.session.state.scene.painted_objects == ("background",)
    page.act("recolor", names=["3"], setting="hue", value=1000)
    assert "hue" in page.said[-1]


def test_strokes_follow_lines_that_are_drawn_and_undo_takes_each_back(page: Page, tmp_path: Path):
    page.act("guide_drawn", name="3", points=[place("3"), place("7")])
    assert "not painted" in page.said.pop()
    painted(page, "3")
    free = page.session.state.scene
    x, y = place("3")
    line = [(x - 0.03, y), (x, y), (x + 0.03, y)]
    (layer,) = page.act("guide_drawn", name="3", points=line, reach=0.3).layers
    assert len(layer.guides) == 1 and len(layer.guides[0]) == 3 and "guides 1" in layer.settings
    for drawn, known in zip(line, layer.guides[0], strict=True):
        pixels = project(torch.tensor([known]), CAMERA)[0][0] / torch.tensor([WIDTH, HEIGHT])
        assert torch.allclose(pixels, torch.tensor(drawn), atol=0.01), "where it was drawn"
    first = page.session.state.scene
    assert page.session.state.note == "Painted 3 like stripes, along 1 line"
    assert not torch.equal(first.layers[0].sh0, free.layers[0].sh0)
    (layer,) = page.act("guide_drawn", name="3", points=[(x, y - 0.03), (x, y + 0.03)]).layers
    assert len(layer.guides) == 2
    page.act("step", rows=-1)
    assert page.session.state.scene.splats is first.splats, "one step, to the bit"
    page.act("save")
    recipe = read_recipe(tmp_path / "balls" / "recipe.json")
    assert recipe.objects[0].style.config.guides == tuple(first.layers[0].settings["guides"])
    again = stylize(open(tmp_path / "balls").without_layers(), recipe, device="cpu")
    found, wanted = again.layers[0].sh0, first.layers[0].sh0
    assert torch.allclose(found, wanted, atol=0.01), "a recipe repeats it, on as many threads"
    (layer,) = page.act("paint", style="turned", names=["3"], settings={"quality": "draft"}).layers
    assert layer.title == "turned" and len(layer.guides) == 1, "another style keeps the lines"
    (layer,) = page.act("repaint_layer", name="3", settings={"guides": []}).layers
    assert not layer.guides
    page.act("guide_drawn", name="3", points=[(0.01, 0.01), (0.02, 0.01)])
    assert "does not lie on 3" in page.said.pop()


def test_a_variant_changes_its_object_alone(page: Page):
    painted(page, "3")
    painted(page, "7")
    of_seven = page.session.state.scene.layers[1]
    state = painted(page, "3", style=1)
    titles = [(each.object, each.title) for each in state.variants]
    assert titles == [("3", "stripes"), ("7", "stripes"), ("3", "turned")]
    first, second, third = (each.id for each in state.variants)
    assert state.current == [second, third]
    state = page.act("use_variant", id=first)
    assert [each.title for each in state.layers] == ["stripes", "stripes"]
    assert state.current == [first, second]
    assert page.session.state.scene.layers[1] is of_seven
    page.act("compare_with", id=third)
    page.look(2, before=True)
    assert page.pictures["before"][1] != page.pictures["after"][1]
    page.act("use_variant", id=third)
    page.look(3, before=True)
    assert page.pictures["before"][1] == page.pictures["after"][1]
    page.act("set_locked", name="3", locked=True)
    page.act("adjust_layer", name="3", strength=0.5)
    page.act("use_variant", id=first)
    assert all("locked" in page.said.pop() for _ in range(2)), "it stays as it is"
    page.act("adjust_layer", name="7", strength=0.5)
    page.look(4, before=True)
    assert page.pictures["before"][0]["look"] == 4, "a locked layer can be compared"
    for _ in range(2):
        page.act("step", rows=-1)

    page.act("star_variant", id=second, starred=True)
    state = page.act("name_variant", id=first, name="calm")
    assert [each.title for each in state.variants] == ["calm", "stripes", "turned"]
    page.act("save")
    folder, wanted = page.session.folder, page.session.state.scene.layers[0]
    page.act("save_as", name="moved")
    for each in (folder, page.session.folder):  # as after a restart
        session = Session(open(each), folder=each)
        kept = Variants(session, Files(), ObjectThumbnails(session, Files()), readonly=False)
        assert [(v.object, v.title, v.starred) for v in kept.cards()] == [
            ("3", "calm", False),
            ("7", "stripes", True),
            ("3", "turned", False),
        ]
        assert kept.current(session.state.scene) == [second, third]
        layer, title = kept.layer(third)
        assert title == "turned" and torch.equal(layer.sh0, wanted.sh0)
        assert all(v.thumbnail for v in kept.cards())
    state = page.act("delete_variant", id=first)
    assert [each.title for each in state.variants] == ["stripes", "turned"]
    assert [each.id for each in state.variants] == [second, third], "the others keep theirs"
    assert state.compared == third
    page.act("use_variant", id=first)
    assert "not there any more" in page.said.pop() and len(state.layers) == 2
    assert page.act("delete_variant", id=third).compared is None


def test_a_snapshot_brings_the_whole_scene_back(page: Page):
    painted(page, "3")
    full = page.session.state.scene.splats
    (kept,) = page.act("snapshot", name="first").snapshots
    assert kept.note == "first" and kept.picture
    page.act("remove_paint", name="3")
    state = page.act("restore", number=kept.number)
    assert torch.equal(page.session.state.scene.splats.sh0, full.sh0)
    assert state.undo == "Restored first"
    page.act("step", rows=-1)
    assert not page.session.state.scene.layers
    assert not page.act("forget_snapshot", number=kept.number).snapshots
    page.act("restore", number=kept.number)
    assert "not there any more" in page.said.pop()


def test_the_picture_before_painting_is_there_to_compare(page: Page):
    page.look(2, before=True)
    assert page.pictures["before"][1] == page.pictures["after"][1]
    painted(page, "3")
    page.look(3, before=True)
    assert page.pictures["before"][0]["look"] == 3
    assert page.pictures["before"][1] != page.pictures["after"][1]


def test_views_are_kept_beside_the_scene_and_a_video_leads_through_them(page: Page):
    places = [((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)), ((3.0, 0.0, 1.0), (0.0, 0.0, 0.0))]
    states = [page.act("keep_view", position=eye, target=target) for eye, target in places]
    state = states[-1]
    assert [each.name for each in state.views if each.position] == ["View 1", "View 2"]
    assert not any(each.url for each in state.views)
    state = page.act("show_views")
    assert page.session.worker.wait_until_idle()
    state = page.actions.state_message()
    assert len(state.views) == 2 + len(CAMERAS) and all(each.url for each in state.views)
    assert state.views[2].photo == 0 and len({each.url for each in state.views}) == 6
    page.act("turntable", path="views", seconds=0.2, fps=20, width=64)
    until(lambda: "balls-path.mp4" in page.files, "a video")
    assert len(page.files["balls-path.mp4"]) > 500
    cameras = page.actions.views.path(3, (64, 48))
    ends = torch.tensor([position for position, _ in places])
    torch.testing.assert_close(cameras.positions[[0, 2]], ends, atol=1e-4, rtol=0)
    page.act("preview_path", seconds=1)
    (flight,) = page.flights
    assert flight.places[0][0] == pytest.approx(places[0][0], abs=1e-4) and len(flight.places) == 20
    assert page.act("level", up=(0, 0.2, 2)).up == pytest.approx((0, 0.0995, 0.995), abs=1e-3)
    page.act("move_view", number=1, to=0)
    page.act("keep_view", position=(0, 0, 1), target=(0, 0, 1))
    assert "straight up or down" in page.said.pop()
    folder = page.session.folder
    state = page.act("save_as", name="moved")
    for each in (folder, page.session.folder):
        kept = KeptViews(Session(open(each), folder=each), Files(), (1.0, 1.0))
        assert [view.name for view in kept.cards()[:2]] == ["View 2", "View 1"]
        assert kept.levelled is not None
    state = page.act("forget_view", number=0)
    assert [each.name for each in state.views if each.position] == ["View 1"]
    page.act("preview_path")
    assert "two kept views" in page.said[-1]


def test_the_shelf_takes_files_of_this_machine_and_lets_sent_ones_go(page: Page, tmp_path: Path):
    gallery, file = page.actions.gallery, tmp_path / "local file.png"
    Image.fromarray(to_uint8(stripes().flip(0)).numpy()).save(file)
    page.act("add_style", path=f"'{file}'")
    page.act("add_style", path=file.as_uri())
    assert [*gallery.pictures].count("local file") == 1 and "local file 2" not in gallery.pictures
    page.act("add_style", path="local file.png")
    assert "the whole path" in page.said.pop()
    Image.fromarray(to_uint8(stripes().flip(-1)).numpy()).save(tmp_path / "other.png")
    sent = gallery.upload("sent.png", (tmp_path / "other.png").read_bytes())
    assert sent.own and sent.path.parent == tmp_path / "balls" / "studio-styles"
    painted(page, "3", style=len(gallery.pictures) - 1)
    page.act("forget_style", title="sent")
    assert "3 has the style of sent" in page.said.pop() and sent.path.exists()
    page.act("step", rows=-1)
    assert "sent" not in [each.title for each in page.act("forget_style", title="sent").styles]
    assert not sent.path.exists()
    page.act("forget_style", title="local file")
    assert "was not sent by a page" in page.said.pop() and file.exists()
    page.actions._is_local = False
    page.act("add_style", path=str(file))
    assert "Drop the file here" in page.said.pop()


BRIEF = {"steps": 4, "object_size": 48}


def test_every_style_can_be_tried(page: Page):
    page.act("pick_names", names=["3"])
    earlier = list[str]()
    page.session.on_progress.append(
        lambda: earlier.append(page.actions.state_message().previews["stripes"])
    )
    state = page.act("try_all", settings=BRIEF)
    first, second = (state.previews[name] for name in ("stripes", "turned"))
    assert first != second
    assert earlier[0] and earlier[0] != first, "a draft follows the colours"
    state = page.act("try_all")
    assert not state.previews, "they are removed"

    def pick_another() -> None:
        page.session.do(lambda state: pick_names(state, ["7"]))

    page.session.on_progress.append(pick_another)
    state = page.act("try_all", settings=BRIEF)
    assert page.names() == ["7"] and page.session.progress is None, "the drafts have ended"
    assert not state.previews, "they were of another object"
    assert not page.session.state.scene.layers


def test_what_was_tried_stays_as_variants(page: Page):
    page.act("pick_names", names=["3"])
    region = {"stripes": (0, 0, 40, 40)}
    state = page.act("try_all", settings=BRIEF | {"rotate": 90.0}, regions=region)
    assert sorted({each.title for each in state.variants}) == ["stripes", "turned"], page.said
    assert all(each.object == "3" and each.thumbnail for each in state.variants)
    assert "rotate 90" in state.variants[1].settings and "region" in state.variants[0].settings
    assert not state.layers, "the scene is as it was"

    state = page.act("rename_picked", name="vase")
    assert {each.object for each in state.variants} == {"vase"}, "they follow their object"
    state = page.act("use_variant", id=state.variants[0].id)
    assert [each.object for each in state.layers] == ["vase"], page.said
    for _ in range(2):
        state = page.act("step", rows=-1)
    assert page.names() == ["3"] == [*{each.object for each in state.variants}]

    base, used = page.session.state.scene.splats, state.variants[1].id
    state = page.act("use_variant", id=used)
    (layer,) = state.layers
    assert layer.values["quality"] == "draft", "it can be finished"
    assert not torch.equal(page.session.state.scene.splats.sh0, base.sh0)
    assert state.previews, "they are still those of what is picked"

    page.act("star_variant", id=used, starred=True)
    page.act("try_all")
    state = page.act("try_all", settings=BRIEF | {"rotate": 90.0})
    known = {(each.title, each.settings) for each in state.variants}
    assert len(state.variants) == len(known) == 3, "the same draft once"
    page.act("compare_with", id=state.variants[0].id)
    again = Variants(
        page.session, page.actions.gallery.files, page.actions.thumbnails, readonly=False
    )
    assert again.cards() == state.variants, "they stay with the scene"


def test_drafts_make_room_before_paintings(page: Page, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("stylesplat.studio_app.variants.MOST_VARIANTS", 2)
    state = painted(page, "3")
    kept = state.variants[0].id
    page.act("pick_names", names=["3", "7"])
    state = page.act("try_all", settings=BRIEF)
    assert len(state.previews) == 2, "of both objects"
    assert [each.object for each in state.variants] == ["3", "7"]
    assert state.variants[0].id == kept, "the drafts have gone, and not the painting"

    page.act("name_variant", id=state.variants[1].id, name="mine")
    page.act("try_all")
    named = page.act("try_all", settings=BRIEF | {"rotate": 90.0}).variants
    assert [each.title for each in named] == [state.variants[0].title, "mine"]
    assert "drafts are not kept" in page.said.pop()


def test_a_picture_that_is_gone_stops_no_other_draft(page: Page):
    page.act("pick_names", names=["3"])
    page.actions.gallery.pictures["stripes"].path.unlink()
    state = page.act("try_all", settings=BRIEF)
    assert [*state.previews] == ["turned"] == [each.title for each in state.variants]
    assert "stripes" in page.said.pop()
    page.act("try_all")
    page.act("try_all", settings={"config": 1})
    assert "config" in page.said.pop()


def test_drafts_of_a_selection_stay_and_become_those_of_its_object(page: Page):
    page.act("pick_names", names=["3"])
    page.act("invert_picked")
    state = page.act("try_all", settings=BRIEF)
    assert len(state.previews) == 2 and {each.object for each in state.variants} == {SELECTION}
    assert all(each.thumbnail for each in state.variants), "with pictures"
    assert {each.name for each in state.objects} == {"3", "7", "300"}, "it is no object yet"

    page.act("pick_names", names=["7"])
    page.act("invert_picked")
    state = page.act("try_all", settings=BRIEF)
    assert len(state.variants) == 4, "another selection's drafts take the place of none"
    mask = page.session.masks.picked(page.session.state)
    assert mask is not None
    state = page.act("name_selection", name="rest")
    assert [each.object for each in state.variants] == [SELECTION] * 2 + ["rest"] * 2, page.said
    assert torch.equal(page.session.state.scene.objects["rest"].mask, mask)

    state = page.act("use_variant", id=state.variants[0].id)
    (layer,) = state.layers
    assert layer.object == "painted part" and page.names() == ["painted part"], page.said
    assert [each.object for each in state.variants] == ["painted part"] * 2 + ["rest"] * 2
    state = page.act("step", rows=-1)
    assert not state.layers and state.variants[0].object == SELECTION, "one step"


def test_the_queue_is_a_list(page: Page):
    removed = list[int]()

    def remove_last() -> None:
        waiting = page.actions.state_message().waiting
        if len(waiting) == 2 and not removed:
            removed.append(waiting[-1][0])
            page.session.ask(lambda: page.actions.queue.remove(removed[0]))

    page.session.on_change.append(remove_last)
    state = painted(page, "3", "7", "300")
    assert removed and [each.object for each in state.layers] == ["3", "7"]


def test_other_strokes_take_the_place_of_a_painting(page: Page):
    session, asked = page.session, list[Style]()
    path = next(iter(page.actions.gallery.pictures.values())).path

    def ask_once() -> None:
        if session.painting and not asked:
            asked.append(Style(path, config=replace(QUICK, rotate=90.0)))
            session.ask(lambda: page.actions.queue.paint(("3",), asked[0], "stripes", instead=True))

    session.on_change.append(ask_once)
    state = painted(page, "3")
    assert len(state.variants) == len(state.layers) == 1, page.said
    assert "rotate 90" in state.layers[0].settings


def test_of_several_styles_in_a_row_the_newest_is_painted(page: Page):
    session, asked = page.session, list[int]()

    def ask_twice_more() -> None:
        if session.painting and len(asked) < 2:
            asked.append(1)
            style = Style(stripes(), config=QUICK)
            session.ask(lambda: page.actions.queue.paint(("3",), style, f"style {len(asked)}"))

    session.on_change.append(ask_twice_more)
    state = painted(page, "3")
    assert [each.title for each in state.variants] == ["style 2"], page.said
    page.act("step", rows=-1)
    assert not session.state.scene.layers, "one undo takes it back"


def test_what_cannot_be_painted_is_told(page: Page):
    for fields, words in (
        ({"style": "stripes", "names": []}, "Nothing is picked"),
        ({"style": "stripes", "names": ["3"], "settings": {"speed": 1}}, "speed"),
        ({"style": "stripes", "names": ["3"], "settings": {"scale": -1}}, "scale"),
        ({"style": "stripes", "names": ["3"], "settings": {"region": [0, 0, 2, 2]}}, "32|little"),
    ):
        page.act("paint", **fields)
        assert any(word in page.said[-1] for word in words.split("|")), page.said[-1]
    assert not page.session.state.scene.layers


def test_files_are_delivered(page: Page):
    page.act("export", ending=".splat")
    until(lambda: bool(page.files), "the export")
    page.act("picture", width=96)
    page.act("turntable", seconds=0.2, fps=10, width=64, around="3", path="circle")
    assert [*page.files] == ["balls.splat", "balls-view.png", "balls-turntable.mp4"], page.said
    assert len(page.files["balls.splat"]) == 32 * len(SPLATS)
    assert b"ftyp" in page.files["balls-turntable.mp4"][:16]
    page.files.clear()
    page.session.on_progress.append(page.actions.deliveries.exporter.cancel)
    page.act("turntable", seconds=1, fps=10, width=64)
    assert not page.files and "cancelled" in page.said[-1]
    page.act("export", ending=".exe")
    assert "no format" in page.said[-1]


def test_saving(page: Page, tmp_path: Path):
    painted(page, "3")
    state = page.act("save")
    assert not state.unsaved and open(tmp_path / "balls").painted_objects == ("3",)
    state = page.act("save_as", name="other")
    assert state.folder == str((tmp_path / "other").resolve())
    words = shlex.split(state.command)
    recipe = read_recipe(words[words.index("--recipe") + 1])
    assert [each.name for each in recipe.objects] == ["3"]
    page.act("save_as", name="../up")
    assert len(page.said) == 3


def test_browsers_with_a_graphics_card_get_the_gaussians(page: Page):
    page.look(2, draws=True)
    header, _ = page.pictures["splats"]
    assert header["count"] == len(SPLATS) and header["bands"] == 0


def test_a_browser_does_not_draw_gaussians_that_are_no_longer_so(page: Page):
    page.look(2, draws=True)
    drawn = list[bool]()

    def keep_drawn() -> None:
        drawn.append(page.pictures["after"][0]["drawn"])

    page.session.on_change.append(keep_drawn)
    painted(page, "3")
    assert not any(drawn[1:]), "of a painting under way"
    page.look(3, draws=True)
    assert page.pictures["after"][0]["drawn"], "it has them by now"


def test_a_large_window_gets_all_its_pixels_in_bands(page: Page):
    pictures = list[tuple[dict[str, Any], tuple[int, int]]]()

    def keep(client: int, kind: object, message: bytes | m.Download) -> None:
        if isinstance(message, bytes):
            length = int.from_bytes(message[:4], "little")
            about, content = json.loads(message[4 : 4 + length]), message[4 + length :]
            if about["kind"] == "picture":
                pictures.append((about, Image.open(io.BytesIO(content)).size))

    page.session.on_send.append(keep)
    page.actions.pictures.leave(1)

    def look(number: int) -> list[tuple[dict[str, Any], tuple[int, int]]]:
        pictures.clear()
        viewmat = CAMERA.viewmats[0].flatten().tolist()
        page.act("look", number=number, viewmat=viewmat, focal=1500.0, size=[1281, 700])
        return [*pictures]

    assert "top" not in look(5)[0][0], "the first one at once, with fewer pixels"
    bands = look(6)  # the camera alone has moved
    rows = [row for about, (_, high) in bands for row in range(about["top"], about["top"] + high)]
    assert len(bands) > 1 and sorted(rows) == [*range(700)]
    assert {(*about["size"], width) for about, (width, _) in bands} == {(1281, 700, 1281)}
    assert [about["last"] for about, _ in bands] == [*[False] * (len(bands) - 1), True]
    assert not look(6), "it has them"

    def turn(client: int, kind: object, message: object) -> None:
        if not turned.is_set():  # the page moves on while the first band is on its way
            turned.set()
            page.session.ask(lambda: page.actions.pictures.look(1, other))

    turned = threading.Event()
    other = msgspec.structs.replace(page.actions.pictures.looks[1], number=8)
    page.session.on_send.append(turn)
    numbers = [about["look"] for about, _ in look(7)]
    assert numbers == [7, *[8] * len(bands)], "bands that nobody sees any more are left out"
    pictures.clear()
    page.session.do(lambda state: recolor_objects(state, ["3"], "hue", 90.0))
    assert page.session.worker.wait_until_idle()
    assert "top" not in pictures[0][0], "other colours are there at once, with fewer pixels"


@pytest.mark.parametrize(
    "text",
    [
        '{"do": "pick_at", "place": [2, 0]}',
        '{"do": "pick_drawn", "shape": "star", "points": [[0, 0]]}',
        '{"do": "look", "number": 1, "viewmat": [1], "focal": 1, "size": [9, 9]}',
        '{"do": "turntable", "seconds": 1e9}',
        '{"do": "stop", "more": 1}',
        '{"do": "picture", "width": 1000000}',
    ],
)
def test_only_what_the_page_may_say_is_understood(page: Page, text: str):
    with pytest.raises(msgspec.ValidationError):
        page.actions.decoder.decode(text)


def test_warming_up_lets_what_is_asked_for_in(page: Page):
    session, done = page.session, list[str]()

    def warm() -> None:
        session.worker.ask(lambda: done.append("click"))
        page.actions.warm_up()
        done.append("warm")

    session.ask(warm, patient=True)
    assert session.worker.wait_until_idle() and done == ["click", "warm"] and not page.said
    assert [each.title for each in page.actions.state_message().styles][2:] == [*MATERIALS]
