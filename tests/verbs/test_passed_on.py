"""Objects and paintings that go out to other programs, and come back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from balls import GREEN, RED, TRAINED, opened
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.ply import read_ply_table
from stylesplat.io.splats.splat_files import row_order
from stylesplat.rendering.render import rasterize
from stylesplat.scene.frames import Frame, move_splats
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.export import export
from stylesplat.verbs.import_ import import_
from stylesplat.verbs.objects import objects
from stylesplat.verbs.select import select

pytestmark = pytest.mark.usefixtures("quick_painting")
FRAME = Frame(
    torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).double(), 2.0, torch.ones(3).double()
)


@pytest.fixture
def painted(stack: Path) -> Scene:
    return opened(stack / "twice")


@pytest.mark.parametrize("suffix", [".ply", ".splat"])
def test_a_sidecar_keeps_objects(suffix: str, tmp_path: Path):
    file = tmp_path / f"balls{suffix}"
    export(TRAINED, file, sidecar=True)
    back = import_(file, labels=tmp_path / f"balls{suffix}.objects.npz", up="z")
    order = row_order(TRAINED.splats, file)
    for name, each in TRAINED.objects.items():
        assert torch.equal(back.objects[name].mask, each.mask[order])
    assert [each["id"] for each in objects(back)] == [each["id"] for each in objects(TRAINED)]
    export(TRAINED, file, objects=["red", "blue"], sidecar=True, overwrite=True)
    part = import_(file, labels=tmp_path / f"balls{suffix}.objects.npz", up="z")
    assert int(part.objects["red"].mask.sum()) == 80 and "green" not in part.objects


def test_a_ply_marks_objects_as_selected(tmp_path: Path):
    export(TRAINED, tmp_path / "plain.ply")
    export(TRAINED, tmp_path / "a.ply", selected=["red", "3"], without=["green"])
    table, plain = read_ply_table(tmp_path / "a.ply"), read_ply_table(tmp_path / "plain.ply")
    kept = ~GREEN.numpy()
    for name in plain.dtype.names or ():
        assert np.array_equal(table[name], plain[name][kept])
    assert table.dtype.names == (*(plain.dtype.names or ()), "state")
    assert (table["state"].astype(bool) >= RED.numpy()[kept]).all() and table["state"].max() == 1
    back = select(import_(tmp_path / "a.ply", up="z"), "red", rows=tmp_path / "a.ply")
    assert torch.equal(back.objects["red"].mask, torch.from_numpy(table["state"] == 1))
    with pytest.raises(StyleSplatError, match=r"no more columns .* Choose a \.ply"):
        export(TRAINED, tmp_path / "b.spz", selected=["red"])
    with pytest.raises(StyleSplatError, match="--sidecar means nothing for a page"):
        export(TRAINED, tmp_path / "a.html", sidecar=True)
    (tmp_path / "c.ply.objects.npz").write_text("mine")
    with pytest.raises(StyleSplatError, match=r"c\.ply\.objects\.npz exists"):
        export(TRAINED, tmp_path / "c.ply", sidecar=True)


def test_picks_go_out_and_come_in(tmp_path: Path):
    path = tmp_path / "picks.npz"
    assert export(TRAINED, path, objects=["red", "300"]) == 2
    bare = replace(TRAINED, objects={})
    again = select(bare, "red", rows=path)
    assert torch.equal(again.objects["red"].mask, RED)
    assert again.objects["red"].selection.rows == (str(path),)
    more = select(again, "both", rows=RED | GREEN, minus="red")
    assert torch.equal(more.objects["both"].mask, GREEN)
    with pytest.raises(StyleSplatError, match="no object 'vase'"):
        select(bare, "vase", rows=path)
    with pytest.raises(StyleSplatError, match="Give a mask of 440"):
        select(bare, "vase", rows=RED[:5])
    with pytest.raises(StyleSplatError, match="has no objects"):
        plain = replace(TRAINED.splats, identities=None, classifier=None)
        export(replace(bare, base=plain), tmp_path / "none.npz")


def edited(scene: Scene, *, frame: Frame | None = None) -> tuple[torch.Tensor, Scene]:
    """Every third Gaussian is gone, the rest in another order; and what it becomes."""
    order = torch.randperm(len(scene.splats), generator=torch.Generator().manual_seed(0))
    order = order[order % 3 != 0]
    splats = replace(scene.splats[order], identities=None, classifier=None, confidence=None)
    return order, import_(splats if frame is None else move_splats(splats, frame), like=scene)


def test_a_splat_that_was_edited_keeps_objects(tmp_path: Path):
    order, found = edited(TRAINED)
    for name, each in TRAINED.objects.items():
        assert torch.equal(found.objects[name].mask, each.mask[order])
    assert found.metrics["lost_gaussians"] == len(TRAINED.splats) - len(order)
    assert found.metrics["new_gaussians"] == 0 and found.metrics["moved"] == []
    assert [each["id"] for each in objects(found)] == [each["id"] for each in objects(TRAINED)]
    assert torch.equal(found.cameras.viewmats, TRAINED.cameras.viewmats)
    scene_folder.save(found, tmp_path / "scene")
    assert opened(tmp_path / "scene").objects.keys() == TRAINED.objects.keys()


def test_layers_are_taken_back_from_an_edited_splat(painted: Scene):
    order, found = edited(painted)
    assert found.painted_objects == painted.painted_objects
    assert len(found.splats) == len(order) and len(found.layers[0].surfels)
    count = len(painted.base)
    own, new = order[order < count], order[order >= count]
    assert torch.equal(found.splats.means, painted.splats.means[torch.cat([own, new])])
    torch.testing.assert_close(found.splats.sh0, painted.splats.sh0[torch.cat([own, new])])
    plain = adjust(found, undo=True)
    torch.testing.assert_close(plain.splats.sh0, painted.base.sh0[own])
    torch.testing.assert_close(plain.splats.opacities, painted.base.opacities[own])


def test_views_and_colours_turn_along(painted: Scene):
    _, still = edited(painted)
    _, found = edited(painted, frame=FRAME)
    assert found.metrics["moved"] == [
        {"gaussians": len(found.splats), "scale": 2.0, "degrees": 90.0}
    ]
    for undo in (False, True):
        one, other = (adjust(each, undo=True) if undo else each for each in (still, found))
        before, _, _ = rasterize(one.splats, one.cameras[0])
        after, _, _ = rasterize(other.splats, other.cameras[0])
        torch.testing.assert_close(after, before, atol=2e-3, rtol=0)


def test_what_is_new_belongs_to_nothing_and_edited_colours_stay(painted: Scene, said: list[str]):
    bright = replace(painted.splats, sh0=painted.splats.sh0 + 1, identities=None, classifier=None)
    bright = replace(bright, confidence=None)
    far = replace(bright[torch.arange(30)], means=bright.means[:30] * 7 + 50)
    both = Splats.cat([bright, far])
    found = import_(both, like=painted)
    assert found.metrics["new_gaussians"] == 30 and not found.layers
    assert not any(each.mask[-30:].any() for each in found.objects.values())
    assert any("become part of the splat" in line for line in said)
    assert torch.equal(found.splats.sh0, both.sh0)


def test_another_scene_is_refused():
    other = replace(TRAINED.splats[torch.arange(100)], means=torch.rand(100, 3) + 90)
    other = replace(other, scales=torch.randn(100, 3), opacities=torch.randn(100))
    with pytest.raises(StyleSplatError, match="shows nothing of the scene"):
        import_(other, like=TRAINED)
    with pytest.raises(StyleSplatError, match="--like has views and labels"):
        import_(other, like=TRAINED, up="z")
