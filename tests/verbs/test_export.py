import math
from dataclasses import replace
from pathlib import Path

import gsply
import numpy as np
import pytest
import torch

from balls import BLUE, PICKS, RED, TRAINED, assert_same_splats, write_painted
from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import open
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.io.splats.splat_ply import read_splat_ply
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.compose import compose
from stylesplat.scene.scene import SceneObject
from stylesplat.scene.splats import Splats
from stylesplat.selection.scene_parts import cut_out, rows_of_part
from stylesplat.verbs.export import export, export_each

pytestmark = pytest.mark.usefixtures("quick_painting")


def from_spz(path: Path) -> Splats:
    data = gsply.read_spz(path)
    shN = np.zeros((len(data), 0, 3), np.float32) if data.shN is None else data.shN
    arrays = (data.means, data.quats, data.scales, data.opacities, data.sh0[:, None], shN)
    means, quats, scales, opacities, sh0, bands = (torch.tensor(array) for array in arrays)
    return Splats(means, quats, scales, opacities, sh0, bands)


def from_splat(path: Path) -> dict[str, np.ndarray]:
    fields = [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)]
    rows = np.frombuffer(path.read_bytes(), np.dtype(fields))
    return {name: rows[name] for name, *_ in fields}


def looking(height: float, *, y_up: bool) -> Cameras:
    """A camera 6 in front of the origin; in a world that is turned, it is turned along."""
    viewmats = torch.eye(4)[None].clone()
    viewmats[:, :3, 3] = torch.tensor([0.2, height, 6.0])
    if y_up:
        viewmats[:, :3, :3] = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    K = torch.tensor([[[40.0, 0, 24], [0, 40, 18], [0, 0, 1]]])
    return Cameras(viewmats, K, torch.tensor([[48, 36]]), ("a",))


@pytest.mark.parametrize("bands", [0, 1, 3])
def test_spz_is_the_same_scene_with_y_up(tmp_path: Path, bands: int):
    """SPZ turns the world by half a turn about x; the image from a turned camera stays."""
    splats = random_splats(sh_degree=bands)
    export(splats, tmp_path / "a.spz")
    found = from_spz(tmp_path / "a.spz")
    assert found.shN.shape == splats.shN.shape
    for height in (0.0, 0.5):
        image, *_ = rasterize(splats, looking(height, y_up=False), backend="reference")
        turned, *_ = rasterize(found, looking(height, y_up=True), backend="reference")
        # Colours and opacities have 8 bits, their sums over a dozen Gaussians a little less
        assert (image - turned).abs().mean() < 0.01
    assert image.max() > 0.5


def test_spz_cannot_express_everything(tmp_path: Path):
    splats = random_splats()
    with pytest.raises(StyleSplatError, match=r"units from the origin.*Export a \.ply"):
        export(replace(splats, means=splats.means * 1e8), tmp_path / "a.spz")
    assert not any(tmp_path.iterdir())


def test_splat_rows(tmp_path: Path):
    splats = random_splats()
    export(splats, tmp_path / "a.splat")
    rows = from_splat(tmp_path / "a.splat")
    order = [
        int((splats.means == torch.from_numpy(mean.copy())).all(1).nonzero())
        for mean in rows["mean"]
    ]
    assert sorted(order) == list(range(200))
    alphas = torch.sigmoid(splats.opacities)[order]
    scales = splats.scales[order].exp()
    importance = scales.prod(dim=1) * alphas
    assert (importance.diff() <= 1e-6).all()
    np.testing.assert_allclose(rows["scale"], scales, rtol=1e-6)
    np.testing.assert_allclose(rows["rgba"][:, 3], 255 * alphas, atol=0.5)
    colors = 0.5 + splats.sh0[order, 0] / (2 * math.sqrt(math.pi))
    np.testing.assert_allclose(rows["rgba"][:, :3], 255 * colors.clamp(0, 1), atol=0.51)
    quats = torch.nn.functional.normalize(splats.quats[order], dim=1)
    # 1 is stored as 255 / 128 - 1
    np.testing.assert_allclose(rows["quat"] / 128.0 - 1, quats, atol=1 / 128)


@pytest.mark.parametrize("suffix", ["ply", "compressed.ply", "spz", "splat", "sog"])
def test_empty_splats(tmp_path: Path, suffix: str):
    export(random_splats(0), tmp_path / f"a.{suffix}")
    assert (tmp_path / f"a.{suffix}").is_file()


@pytest.mark.parametrize("name", ["a.obj", "a", "a.ply.gz"])
def test_unknown_suffix(tmp_path: Path, name: str):
    with pytest.raises(
        StyleSplatError,
        match=r"unknown suffix .*Use \.ply, .*\.spz, .*\.sog, \.glb, \.gltf, or \.html",
    ):
        export(random_splats(), tmp_path / name)


def test_files_are_replaced_only_if_told_so(tmp_path: Path):
    path = tmp_path / "a.ply"
    path.write_text("old")
    with pytest.raises(StyleSplatError, match=r"a\.ply exists.*--overwrite.*overwrite=True"):
        export(random_splats(), path)
    assert path.read_text() == "old"
    export(random_splats(), path, overwrite=True)
    assert len(read_splat_ply(path)) == 200


@pytest.mark.parametrize(("used", "degree"), [(0, 0), (1, 1), (8, 2), (9, 3)])
def test_bands_of_zeros_are_left_out_where_space_counts(tmp_path: Path, used: int, degree: int):
    splats = random_splats()
    splats.shN[:, used:] = 0
    for suffix in ("spz", "compressed.ply", "glb"):
        export(splats, tmp_path / f"a.{suffix}")
        assert read_splats(tmp_path / f"a.{suffix}").sh_degree == degree
    export(splats, tmp_path / "a.ply")
    assert read_splats(tmp_path / "a.ply").sh_degree == 3


@pytest.mark.parametrize("suffix", ["ply", "compressed.ply", "spz", "sog", "glb"])
@pytest.mark.parametrize("degree", [0, 2])
def test_degrees_that_are_asked_for(tmp_path: Path, suffix: str, degree: int):
    splats, path = random_splats(), tmp_path / f"a.{suffix}"
    export(splats, path, sh_degree=degree)
    found, bands = read_splats(path), (degree + 1) ** 2 - 1
    assert found.sh_degree == degree
    if suffix == "ply":
        assert torch.equal(found.shN, splats.shN[:, :bands])
    # Bands that nobody has are 0
    export(replace(splats, shN=splats.shN[:, :0]), path, sh_degree=degree, overwrite=True)
    assert read_splats(path).shN.shape[1] == bands


def test_degrees_that_cannot_be(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"a \.splat has one colour .*Leave the degree out"):
        export(random_splats(), tmp_path / "a.splat", sh_degree=1)
    with pytest.raises(StyleSplatError, match=r"no degree of colour 4\. Use 0, 1, 2, 3"):
        export(random_splats(), tmp_path / "a.ply", sh_degree=4)
    assert not any(tmp_path.iterdir())
    export(random_splats(), tmp_path / "a.splat", sh_degree=0)


# Objects alone, left out, or each in a file of its own


def test_parts_fit_together_again(tmp_path: Path):
    whole = TRAINED.splats
    assert export(TRAINED, tmp_path / "two.ply", objects=["red", "blue"]) == 160
    assert export(TRAINED, tmp_path / "others.ply", without=["red", "blue"]) == len(whole) - 160
    two, others = (read_splat_ply(tmp_path / f"{name}.ply") for name in ("two", "others"))
    mine = RED | BLUE
    assert torch.equal(two.means, whole.means[mine]) and torch.equal(two.shN, whole.shN[mine])
    assert torch.equal(others.means, whole.means[~mine])
    export(TRAINED, tmp_path / "red.ply", objects=["both"], without=["green"])
    assert torch.equal(read_splat_ply(tmp_path / "red.ply").means, whole.means[RED])


def test_each_object_has_a_file_and_so_has_the_rest(tmp_path: Path):
    plain = replace(TRAINED.splats, identities=None, classifier=None)
    one = replace(TRAINED, splats=plain, objects={"red": TRAINED.objects["red"]})
    files = export_each(one, tmp_path / "parts", suffix=".splat")
    assert [path.name for path in files] == ["red.splat", "rest.splat"]
    assert {*(tmp_path / "parts").iterdir()} == {*files}
    files = export_each(TRAINED, tmp_path / "four")
    assert [path.stem for path in files] == [*PICKS, "3", "7", "300", "rest"]
    found = {path.stem: read_splat_ply(path).means for path in files}
    assert torch.equal(found["blue"], TRAINED.splats.means[BLUE])
    (tmp_path / "four" / "mine.txt").write_text("mine")
    with pytest.raises(StyleSplatError, match="something else"):
        export_each(TRAINED, tmp_path / "four")
    export_each(one, tmp_path / "four", overwrite=True)
    assert (tmp_path / "four" / "mine.txt").read_text() == "mine"


def test_a_part_of_a_painted_scene_knows_what_was_before(tmp_path: Path):
    folder = write_painted(tmp_path, "blue", lambda wave, night: night)
    scene = open(folder / "twice")
    part = cut_out(scene, rows_of_part(scene, ["red"]))
    own = scene.objects["red"].picked[: len(scene.unpainted)]
    assert_same_splats(part.unpainted, scene.unpainted[own])
    assert_same_splats(part.splats, scene.splats[scene.objects["red"].picked])
    assert part.painted_objects == ("red",), "of the other nothing is there"
    assert_same_splats(compose(part.unpainted, part.layers), part.splats)
    rest = cut_out(scene, rows_of_part(scene, without=["both", "blue"]))
    assert rest.layers == () and rest.base is None
    export(scene, tmp_path / "blue.html", objects=["blue"])
    assert (tmp_path / "blue.html").stat().st_size > 10_000


def test_what_cannot_be_cut_out_is_told(tmp_path: Path):
    with pytest.raises(StyleSplatError, match="no object 'vase'"):
        export(TRAINED, tmp_path / "a.ply", objects=["vase"])
    with pytest.raises(StyleSplatError, match="Nothing is left"):
        export(TRAINED, tmp_path / "a.ply", objects=["red"], without=["both"])
    with pytest.raises(StyleSplatError, match="Splats alone have no objects"):
        export(TRAINED.splats, tmp_path / "a.ply", objects=["red"])
    plain = replace(TRAINED.splats, identities=None, classifier=None)
    with pytest.raises(StyleSplatError, match="has no objects"):
        export_each(replace(TRAINED, splats=plain, objects={}), tmp_path / "parts")
    called = replace(TRAINED, objects={"rest": SceneObject(RED)})
    with pytest.raises(StyleSplatError, match="An object is called 'rest'"):
        export_each(called, tmp_path / "parts")
    assert not [*tmp_path.iterdir()]
