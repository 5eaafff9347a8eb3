"""Splats as OpenUSD has them."""

from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats import splat_usd
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.scene.frames import Frame, move_splats
from stylesplat.scene.splats import Splats

pytest.importorskip("pxr", reason="usd-core is not installed (the extra `usd`)")
Gf, Usd, UsdGeom, UsdVol = (
    import_module(f"pxr.{name}") for name in ("Gf", "Usd", "UsdGeom", "UsdVol")
)
TURN = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def close(one: Splats, other: Splats, tolerance: float = 1e-5) -> bool:
    turned = torch.nn.functional.normalize(one.quats, dim=1)
    aligned = (turned * torch.nn.functional.normalize(other.quats, dim=1)).sum(dim=1).abs()
    names = ("means", "scales", "opacities", "sh0", "shN")
    pairs = [(getattr(one, name), getattr(other, name)) for name in names]
    same = all(torch.allclose(a, b, atol=tolerance) for a, b in pairs)
    return same and bool((aligned > 1 - tolerance).all())


@pytest.mark.parametrize("suffix", [".usd", ".usdc", ".usda"])
def test_round_trip(suffix: str, tmp_path: Path):
    splats = random_splats(20)
    write_splats(splats, tmp_path / f"a{suffix}")
    found = read_splats(tmp_path / f"a{suffix}")
    assert close(found, splats)
    if suffix != ".usda":  # text has nine digits
        assert torch.equal(found.means, splats.means) and torch.equal(found.shN, splats.shN)


def test_what_others_see(tmp_path: Path):
    splats = random_splats(3)
    write_splats(splats, tmp_path / "a.usdc", sh_degree=1)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert len(prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get()) == 3 * 4
    quat = prim.GetOrientationsAttr().Get()[1]
    unit = torch.nn.functional.normalize(splats.quats[1], dim=0)
    assert torch.allclose(torch.tensor([quat.GetReal(), *quat.GetImaginary()]), unit, atol=1e-6)
    assert prim.GetOpacitiesAttr().Get()[0] == pytest.approx(float(splats.opacities[0].sigmoid()))
    up = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0).Transform(Gf.Vec3d(0, -1, 0))
    assert tuple(up) == (0, 1, 0), "what was up, y being down, is up"


def test_transforms_are_done(tmp_path: Path):
    splats = random_splats(10)
    write_splats(splats, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    prim = UsdGeom.Xformable(stage.GetDefaultPrim())
    prim.ClearXformOpOrder()
    matrix = torch.eye(4).double()
    half_turn = splat_usd.HALF_TURN
    matrix[:3, :3] = 2 * half_turn @ TURN.double()
    matrix[:3, 3] = half_turn @ torch.tensor([1.0, 2.0, 3.0]).double()
    prim.MakeMatrixXform().Set(Gf.Matrix4d(*matrix.T.flatten().tolist()))
    stage.Save()
    expected = move_splats(splats, Frame(TURN, 2.0, torch.tensor([1.0, 2.0, 3.0])))
    assert close(read_splats(tmp_path / "a.usda"), expected, 1e-4)


def test_files_that_are_refused(tmp_path: Path):
    (tmp_path / "a.usd").write_bytes(b"PXR-USDC" + bytes(80))
    (tmp_path / "b.usda").write_text("#usda 1.0\n(\n    subLayers = [@../c.usda@]\n)\n")
    (tmp_path / "c.usda").write_text("#usda 1.0\n")
    for name, fault in (("a.usd", "Cannot read"), ("b.usda", "refers to"), ("c.usda", "no sets")):
        with pytest.raises(StyleSplatError, match=fault):
            read_splats(tmp_path / name)
    write_splats(random_splats(4), tmp_path / "d.usda")
    text = (tmp_path / "d.usda").read_text()
    for old, new, fault in (
        ("float[] opacities", "float[] others", "no opacities"),
        ("( (-1, 0, 0, 0)", "( (-2, 0, 0, 0)", "stretches"),
        ("float3[] scales", "float3[] others", "no scales"),
    ):
        assert old in text
        (tmp_path / "e.usda").write_text(text.replace(old, new))
        with pytest.raises(StyleSplatError, match=fault):
            read_splats(tmp_path / "e.usda")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"#usda 1.0", b"#usda 1.0\n\xff\xfe"),  # of which a message is made that is no text
        (b"point3f[] positions = [", b"point3f[] positions = [(1, 2, "),
        (b"float[] opacities", b"float opacities = 1\nfloat[] others"),
        (b"float3[] scales", b'string scales = "a"\nfloat3[] others'),
    ],
)
def test_damaged_files(tmp_path: Path, before: bytes, after: bytes):
    write_splats(random_splats(5), tmp_path / "a.usda")
    content = (tmp_path / "a.usda").read_bytes()
    assert before in content
    (tmp_path / "b.usda").write_bytes(content.replace(before, after, 1))
    with pytest.raises(StyleSplatError, match="as USD: it ") as caught:
        read_splats(tmp_path / "b.usda")
    assert "\n" not in str(caught.value)


def test_files_of_which_the_library_dies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write_splats(random_splats(5), tmp_path / "a.usdc")
    (tmp_path / "dying.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    monkeypatch.setattr(splat_usd, "usd_trial", SimpleNamespace(__file__=tmp_path / "dying.py"))
    with pytest.raises(StyleSplatError, match=r"damaged \(OpenUSD's library"):
        read_splats(tmp_path / "a.usdc")


def test_without_usd_core(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(splat_usd, "find_spec", lambda name: None)
    with pytest.raises(StyleSplatError, match=r"stylesplat\[usd\]"):
        write_splats(random_splats(3), tmp_path / "a.usd")
