import math
from dataclasses import replace
from pathlib import Path

import gsply
import numpy as np
import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.io.splats.splat_ply import read_splat_ply
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats, sh_basis
from stylesplat.verbs.export import export

SHARED = Path(__file__).parents[2] / "shared" / "data" / "splats" / "metalsplatter"


def random_splats(count: int = 50, bands: int = 15) -> Splats:
    generator = torch.Generator().manual_seed(0)
    return Splats(
        means=torch.randn(count, 3, generator=generator),
        quats=torch.randn(count, 4, generator=generator),
        scales=torch.randn(count, 3, generator=generator) * 0.5 - 2,
        opacities=torch.randn(count, generator=generator) + 1,
        sh0=torch.randn(count, 1, 3, generator=generator),
        shN=torch.randn(count, bands, 3, generator=generator) * 0.1,
    )


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


def test_ply_keeps_every_bit(tmp_path: Path):
    splats = random_splats()
    export(splats, tmp_path / "a.PLY")
    found = read_splat_ply(tmp_path / "a.PLY")
    assert all(torch.equal(t, found.tensors()[k]) for k, t in splats.tensors().items())


@pytest.mark.parametrize("bands", [0, 3, 8, 15])
def test_spz_is_the_same_scene_with_y_up(tmp_path: Path, bands: int):
    """SPZ turns the world by half a turn about x; the image from a turned camera stays."""
    splats = random_splats(bands=bands)
    export(splats, tmp_path / "a.spz")
    found = from_spz(tmp_path / "a.spz")
    assert found.shN.shape == splats.shN.shape
    for height in (0.0, 0.5):
        image, *_ = rasterize(splats, looking(height, y_up=False), backend="reference")
        turned, *_ = rasterize(found, looking(height, y_up=True), backend="reference")
        # Colours and opacities have 8 bits, their sums over a dozen Gaussians a little less
        assert (image - turned).abs().mean() < 0.01
    assert image.max() > 0.5


def test_spz_turns_the_colours_along(tmp_path: Path):
    splats = random_splats()
    export(splats, tmp_path / "a.spz")
    found = from_spz(tmp_path / "a.spz").shN
    dirs = torch.nn.functional.normalize(splats.means, dim=1)
    bases, turned = sh_basis(3, dirs), sh_basis(3, dirs * torch.tensor([1.0, -1.0, -1.0]))
    # Each band by itself: a coefficient has 8 bits for -1 to 1, a basis function is below 3
    torch.testing.assert_close(
        turned[:, 1:, None] * found, bases[:, 1:, None] * splats.shN, atol=3 / 256, rtol=0
    )


@pytest.mark.parametrize("size", [1e-3, 1.0, 3000.0])
def test_spz_positions_are_as_fine_as_the_scene_allows(tmp_path: Path, size: float):
    splats = random_splats()
    splats = replace(splats, means=splats.means * size)
    export(splats, tmp_path / "a.spz")
    error = from_spz(tmp_path / "a.spz").means * torch.tensor([1.0, -1.0, -1.0]) - splats.means
    assert error.abs().max() <= max(2**-21, 2 * splats.means.abs().max() / 2**23)


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
    assert sorted(order) == list(range(50))
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
    with pytest.raises(
        StyleSplatError, match=r"a\.ply exists already.*--overwrite.*overwrite=True"
    ):
        export(random_splats(), path)
    assert path.read_text() == "old"
    export(random_splats(), path, overwrite=True)
    assert len(read_splat_ply(path)) == 50


@pytest.mark.parametrize("suffix", ["ply", "compressed.ply", "spz", "sog", "glb"])
@pytest.mark.parametrize("degree", range(4))
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


@pytest.mark.parametrize(("used", "degree"), [(0, 0), (1, 1), (3, 1), (4, 2), (8, 2), (9, 3)])
def test_bands_of_zeros_are_left_out_where_space_counts(tmp_path: Path, used: int, degree: int):
    splats = random_splats()
    splats.shN[:, used:] = 0
    for name, expected in (
        ("a.spz", degree),
        ("a.compressed.ply", degree),
        ("a.glb", degree),
        ("a.ply", 3),
    ):
        export(splats, tmp_path / name)
        assert read_splats(tmp_path / name).sh_degree == expected


def test_degrees_that_cannot_be(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"a \.splat has one colour .*Leave the degree out"):
        export(random_splats(), tmp_path / "a.splat", sh_degree=1)
    with pytest.raises(StyleSplatError, match=r"no degree of colour 4\. Use 0, 1, 2, 3"):
        export(random_splats(), tmp_path / "a.ply", sh_degree=4)
    assert not any(tmp_path.iterdir())
    export(random_splats(), tmp_path / "a.splat", sh_degree=0)


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the developers' data")
def test_same_as_another_project_wrote(tmp_path: Path):
    (source,) = SHARED.glob("*.ply")
    splats = read_splat_ply(source)
    export(splats, tmp_path / "a.spz")
    ours, theirs = from_spz(tmp_path / "a.spz"), from_spz(source.with_suffix(".spz"))
    torch.testing.assert_close(ours.means, theirs.means, atol=2**-12, rtol=0)
    torch.testing.assert_close(ours.quats, theirs.quats, atol=1 / 100, rtol=0)
    torch.testing.assert_close(ours.sh0, theirs.sh0, atol=0.03, rtol=0)
    export(splats, tmp_path / "a.splat")
    ours, theirs = from_splat(tmp_path / "a.splat"), from_splat(source.with_suffix(".splat"))
    for name, tolerance in (("mean", 1e-5), ("scale", 1e-5), ("rgba", 1), ("quat", 1)):
        a, b = (np.sort(rows[name].astype(float), axis=0) for rows in (ours, theirs))
        np.testing.assert_allclose(a, b, atol=tolerance, err_msg=name)
