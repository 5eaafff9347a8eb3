import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from scipy.spatial.transform import Rotation

from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.scene.frames import Frame, move_splats
from stylesplat.scene.splats import Splats

Gf, Usd, UsdGeom, UsdValidation = (
    pytest.importorskip(f"pxr.{name}") for name in ("Gf", "Usd", "UsdGeom", "UsdValidation")
)
SUFFIXES = [".usd", ".usda", ".usdc", ".usdz"]
FIELD = "/Scene/Splats"


def some(degree: int = 1) -> Splats:
    splats = replace(random_splats(30, sh_degree=degree), identities=None)
    return replace(splats, quats=torch.nn.functional.normalize(splats.quats, dim=1))


def written(folder: Path, splats: Splats | None = None) -> Path:
    path = folder / "a.usda"
    write_splats(some() if splats is None else splats, path)
    return path


def edited(path: Path, *changes: tuple[str, str]) -> Path:
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    return path


def assert_same(found: Splats, expected: Splats, tolerance: float = 1e-6) -> None:
    for name in ("means", "scales", "sh0", "shN"):
        given = getattr(expected, name)
        torch.testing.assert_close(getattr(found, name), given, atol=tolerance, rtol=tolerance)
    alphas = [splats.opacities.sigmoid() for splats in (found, expected)]
    torch.testing.assert_close(*alphas, atol=1e-7, rtol=0)
    cosines = (found.quats * expected.quats).sum(dim=1).abs()
    torch.testing.assert_close(cosines, torch.ones(len(found)), atol=1e-6, rtol=0)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("degree", [0, 3])
def test_what_is_written_is_read_back(tmp_path: Path, degree: int, suffix: str):
    splats, path = some(degree), tmp_path / f"a{suffix}"
    write_splats(splats, path)
    found = read_splats(path)
    assert found.sh_degree == degree
    assert_same(found, splats)
    for name in ("means", "sh0", "shN"):  # stored as they are, and not turned
        assert torch.equal(getattr(found, name), getattr(splats, name))
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
def test_pixars_validators_find_no_fault(tmp_path: Path, suffix: str):
    path = tmp_path / f"a{suffix}"
    write_splats(some(), path)
    stage = Usd.Stage.Open(str(path))
    registry = UsdValidation.ValidationRegistry()
    names = [each.name for each in registry.GetAllValidatorMetadata()]
    context = UsdValidation.ValidationContext(registry.GetOrLoadValidatorsByName(names))
    assert len(names) > 20 and not context.Validate(stage)
    field = stage.GetPrimAtPath(FIELD)
    assert field.GetTypeName() == "ParticleField3DGaussianSplat"
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert field.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get().__len__() == 30 * 4


def test_the_world_stands_upright_in_usd(tmp_path: Path):
    splats = some()
    stage = Usd.Stage.Open(str(written(tmp_path, splats)))
    field = UsdGeom.Imageable(stage.GetPrimAtPath(FIELD))
    matrix = field.ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    placed = matrix.Transform(Gf.Vec3d(*splats.means[0].tolist()))
    x, y, z = splats.means[0].tolist()
    assert tuple(placed) == pytest.approx((-x, -y, z))
    low, high = UsdGeom.Boundable(field).GetExtentAttr().Get()
    for axis in range(3):
        assert low[axis] < splats.means[:, axis].min() <= splats.means[:, axis].max() < high[axis]


def test_transforms_above_the_splats_are_applied(tmp_path: Path):
    turn = Rotation.from_euler("xyz", [20, 30, 40], degrees=True)
    x, y, z, w = turn.as_quat()
    splats = some(2)
    path = edited(
        written(tmp_path, splats),
        ("quatd xformOp:orient = (0, 0, 0, 1)", f"quatd xformOp:orient = ({w}, {x}, {y}, {z})"),
        (
            'xformOpOrder = ["xformOp:orient"]',
            'xformOpOrder = ["xformOp:translate", "xformOp:orient", "xformOp:scale"]\n'
            "double3 xformOp:translate = (1, 2, 3)\nfloat3 xformOp:scale = (2, 2, 2)",
        ),
    )
    half = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
    shift = half @ torch.tensor([1.0, 2, 3], dtype=torch.float64)
    expected = move_splats(splats, Frame(half @ torch.from_numpy(turn.as_matrix()), 2.0, shift))
    assert_same(read_splats(path), expected, 1e-5)


def test_z_up_becomes_minus_y(tmp_path: Path):
    splats = some(0)
    path = edited(
        written(tmp_path, splats),
        ('upAxis = "Y"', 'upAxis = "Z"'),
        ("(0, 0, 0, 1)", "(1, 0, 0, 0)"),
    )
    x, y, z = splats.means.unbind(dim=1)
    torch.testing.assert_close(read_splats(path).means, torch.stack([-x, -z, -y], dim=1))


def test_half_precision_and_defaults(tmp_path: Path, said: list[str]):
    text = """#usda 1.0
def ParticleField3DGaussianSplat "A"
{
    point3h[] positionsh = [(0, 0, 0), (1, 2, 3)]
    float[] opacities = [0.5]
    uniform int radiance:sphericalHarmonicsDegree = 0
    half3[] radiance:sphericalHarmonicsCoefficientsh = [(1, 0, 0), (0, 1, 0)]
}
def ParticleField3DGaussianSplat "B"
{
    token visibility = "invisible"
    point3f[] positions = [(0, 0, 0)]
}
"""
    path = tmp_path / "a.usda"
    path.write_text(text)
    found = read_splats(path)
    assert found.means.tolist() == [[0, 0, 0], [-1, -2, 3]]
    assert found.sh0[:, 0].tolist() == [[1, 0, 0], [0, 1, 0]]
    assert torch.equal(found.scales, torch.zeros(2, 3)) and (found.opacities.sigmoid() == 1).all()
    assert len(said) == 2 and "opacities" in said[0] + said[1] and "/B" in said[0] + said[1]


def test_a_world_with_an_offset(tmp_path: Path, said: list[str]):
    splats = replace(some(), world_offset=(448262.0, 5411932.0, 35.0))
    found = read_splats(written(tmp_path, splats))
    offset = torch.tensor(found.world_offset, dtype=torch.float64)
    expected = splats.means.double() + torch.tensor(splats.world_offset, dtype=torch.float64)
    torch.testing.assert_close(found.means.double() + offset, expected, atol=1e-6, rtol=0)


BAD = {
    "no splats": ('#usda 1.0\ndef Mesh "M" {}\n', "Mesh"),
    "empty": ("#usda 1.0\n", "no splats"),
    "no positions": ('#usda 1.0\ndef ParticleField3DGaussianSplat "A" {}\n', "/A"),
    "missing file": ("#usda 1.0\n(\n subLayers = [@gone.usda@]\n)\n", "gone.usda"),
    "syntax": ('#usda 1.0\ndef Mesh "M" {', "Expected }"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_stage_without_splats_is_refused(tmp_path: Path, name: str):
    text, fact = BAD[name]
    path = tmp_path / "a.usda"
    path.write_text(text)
    with pytest.raises(StyleSplatError) as error:
        read_splats(path)
    assert str(path) in str(error.value) and fact in str(error.value)


def test_files_outside_the_folder_are_refused(tmp_path: Path):
    (tmp_path / "inner").mkdir()
    written(tmp_path)
    (tmp_path / "inner" / "b.usda").write_text("#usda 1.0\n(\n subLayers = [@../a.usda@]\n)\n")
    with pytest.raises(StyleSplatError, match=r"a\.usda"):
        read_splats(tmp_path / "inner" / "b.usda")
    (tmp_path / "b.usda").write_text("#usda 1.0\n(\n subLayers = [@a.usda@]\n)\n")
    assert len(read_splats(tmp_path / "b.usda")) == 30


def test_transforms_that_stretch_are_refused(tmp_path: Path):
    path = edited(
        written(tmp_path),
        ('["xformOp:orient"]', '["xformOp:scale"]\nfloat3 xformOp:scale = (1, 2, 1)'),
    )
    with pytest.raises(StyleSplatError, match="stretches"):
        read_splats(path)


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = written(tmp_path)
    for name in ("pxr", "pxr.Gf"):
        monkeypatch.setitem(sys.modules, name, None)
    for call in (lambda: read_splats(path), lambda: write_splats(some(), tmp_path / "b.usd")):
        with pytest.raises(StyleSplatError, match=r"stylesplat\[usd\]"):
            call()
