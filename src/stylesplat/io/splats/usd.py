"""Splats in OpenUSD files (`.usd`, `.usda`, `.usdc`, `.usdz`) as `ParticleField3DGaussianSplat`.

The schema came with OpenUSD 26.03 (https://openusd.org, `UsdVol`). It has standard deviations and
opacities where PLY has logarithms and logits; its harmonics are the INRIA code's. Read and written
by OpenUSD's own library, which the extra `usd` installs.
"""

import math
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes
from stylesplat.io.splats.packing import PACKED_SMALLEST, logits, unit_quats
from stylesplat.io.splats.splat_ply import MAX_DEGREE, THICKNESS_2D, joined, refuse_faulty
from stylesplat.progress import say
from stylesplat.scene.frames import move_splats, similarity_frame
from stylesplat.scene.splats import Splats, sh_bases
from stylesplat.scene.world_offset import ORIGIN

USD_BINARY, USD_TEXT = b"PXR-USDC", b"#usda "  # what files begin with
USD_INSIDE = (".usd", ".usda", ".usdc")  # of a package, whose first file is one of these
USD_PACKAGE = ".usdz"
FIELD, SPLAT_FIELD = "ParticleField", "ParticleField3DGaussianSplat"
ELLIPSOID = "ParticleFieldKernelGaussianEllipsoidAPI"
SURFLET = "ParticleFieldKernelGaussianSurfletAPI"
USD_DEGREE = "radiance:sphericalHarmonicsDegree"
COEFFICIENTS = "radiance:sphericalHarmonicsCoefficients"
CUTOFF = 3.0  # standard deviations, within which the extent holds a Gaussian
# From a stage's world to ours (COLMAP's): x right, y down, z forward
USD_TURNS = {"Y": np.diag([-1.0, -1, 1]), "Z": np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])}


def read_usd(path: Path | str) -> Splats:
    """Read the splats that a stage shows at its first time, into PLY's axes.

    The transforms of their prims are applied, and the stage's up axis becomes -y, as COLMAP has it;
    units stay. So a file that StyleSplat wrote comes back as it was. Several fields become one.
    """
    path = Path(path)
    pxr = _library(path)
    with _diagnostics(pxr), _named_by_content(path) as named:
        stage = _opened(named, pxr)
        turn = USD_TURNS[str(pxr.UsdGeom.GetStageUpAxis(stage)).upper()]
        fields = _fields(stage, path, pxr)
        parts = [_placed(prim, kernel, turn, path, pxr) for prim, kernel in fields]
    return joined(parts)


def _library(path: Path) -> Any:
    """OpenUSD's library, from the version that has the schema on."""
    try:
        for name in ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdUtils", "UsdVol", "Vt"):
            import_module(f"pxr.{name}")
        pxr: Any = import_module("pxr")  # which has no types
        _ = pxr.UsdVol.ParticleField3DGaussianSplat
    except (ImportError, AttributeError) as error:
        raise StyleSplatError(
            f"USD, such as {path}, needs usd-core 26.3 or newer. Run `pip install "
            "'stylesplat[usd]'`, or take a .ply."
        ) from error
    return pxr


@contextmanager
def _diagnostics(pxr: Any) -> Iterator[None]:
    """Keep the library's warnings off stderr; its errors are exceptions."""
    delegate = pxr.UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    finally:
        delegate.TakeUncoalescedDiagnostics()


@contextmanager
def _named_by_content(path: Path) -> Iterator[Path]:
    """The file under a name by which the library knows its form; a copy if its own does not say."""
    head = read_bytes(path, first=len(USD_BINARY))
    form = ".usdc" if head == USD_BINARY else ".usda" if head.startswith(USD_TEXT) else USD_PACKAGE
    if path.suffix.lower() in ((form,) if form == USD_PACKAGE else (form, ".usd")):
        yield path
        return
    with TemporaryDirectory() as folder:
        yield Path(shutil.copyfile(path, Path(folder) / f"splats{form}"))


def _opened(path: Path, pxr: Any) -> Any:
    """The stage of a file; a ValueError if it, or a file that it names, cannot be used."""
    try:
        stage = pxr.Usd.Stage.Open(str(path.resolve()))
    except pxr.Tf.ErrorException as error:
        raise ValueError(_commentary(error.args)) from None  # whose text may be no UTF-8
    errors, folder = stage.GetCompositionErrors(), path.resolve().parent
    if errors:
        raise ValueError(f"what it names cannot be read: {str(errors[0]).splitlines()[0]:.200}")
    for layer in stage.GetUsedLayers():
        found = layer.realPath.split("[")[0]  # of a package, in which it is
        if found and not Path(found).resolve().is_relative_to(folder):
            fault = f"it names {shorten(found)!r}, which is outside its folder"
            raise ValueError(f"{fault}. Copy all its files into one")
    return stage


def _commentary(errors: Sequence[Any]) -> str:
    """What the library says about its first error, without the place in its code."""
    try:
        return str(errors[0].commentary).strip() or "it is damaged"
    except (UnicodeDecodeError, IndexError, AttributeError):
        return "its text is not UTF-8"


def _fields(stage: Any, path: Path, pxr: Any) -> Iterator[tuple[Any, str]]:
    """The fields of Gaussians that are shown, and the kernel of each."""
    Usd, UsdGeom = pxr.Usd, pxr.UsdGeom
    found, others = 0, set[str]()
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        kind, applied = prim.GetTypeName(), prim.GetAppliedSchemas()
        if kind not in (FIELD, SPLAT_FIELD):
            others.add(str(kind))
        elif UsdGeom.Imageable(prim).ComputeVisibility() == UsdGeom.Tokens.invisible:
            say(f"{path} hides {prim.GetPath()}: left out.")
        elif kind == SPLAT_FIELD or ELLIPSOID in applied or SURFLET in applied:
            found += 1
            yield prim, SURFLET if SURFLET in applied else ELLIPSOID
        else:
            say(f"{path} has particles that are no Gaussians, {prim.GetPath()}: left out.")
    if not found:
        kinds = ", ".join(sorted(others - {""})[:4]) or "nothing"
        raise ValueError(f"it holds no splats (no {SPLAT_FIELD}), but {kinds}")


def _placed(prim: Any, kernel: str, turn: Float[np.ndarray, "3 3"], path: Path, pxr: Any) -> Splats:
    """The splats of a field, in our world, at its first time."""
    first = pxr.Usd.TimeCode.EarliestTime()
    splats = _splats(prim, kernel, path, first)
    matrix = np.array(pxr.UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(first)).T
    frame = similarity_frame(turn @ matrix[:3, :3], turn @ matrix[:3, 3], str(prim.GetPath()))
    if frame is None:
        return splats
    return move_splats(replace(splats, means=splats.means.double()), frame)


def _splats(prim: Any, kernel: str, path: Path, time: Any) -> Splats:
    """The splats of a field in its own frame; what it lacks has the schema's defaults."""
    means = _rows(prim, "positions", 3, time)
    if means is None or not len(means):
        raise ValueError(f"{prim.GetPath()} has no positions, so no Gaussians")
    count = len(means)

    def column(name: str, width: int, *default: float) -> Float[Tensor, "N D"]:
        found = _rows(prim, name, width, time)
        if found is None or len(found) < count:
            if found is not None:
                say(f"{path} has {len(found):,} {name} for {count:,} Gaussians: left out.")
            return torch.tensor(default).expand(count, width)
        return found[:count]

    quats = column("orientations", 4, 0.0, 0.0, 0.0, 1.0)[:, [3, 0, 1, 2]]  # the library has xyzw
    scales = column("scales", 3, 1.0, 1.0, 1.0).abs().log()
    if kernel == SURFLET:
        scales = torch.cat([scales[:, :2], torch.full((count, 1), math.log(THICKNESS_2D))], dim=1)
    opacities = logits(column("opacities", 1, 1.0)[:, 0])
    colors = _harmonics(prim, count, path, time)
    sh0, shN = colors[:, :1].contiguous(), colors[:, 1:].contiguous()
    return Splats(means, quats, scales, opacities, sh0, shN)


def _rows(prim: Any, name: str, width: int, time: Any) -> Float[Tensor, "M D"] | None:
    """The numbers of an attribute as float32, also of its half-precision twin; None without any."""
    for each in (name, f"{name}h"):
        attribute = prim.GetAttribute(each)
        found = attribute.Get(time) if attribute else None
        if found is not None and len(found):
            array = np.asarray(found)
            if array.dtype.kind != "f" or array.size != len(array) * width:
                raise ValueError(f"{prim.GetPath()} has {each} of another type than the schema's")
            return torch.from_numpy(array.astype(np.float32).reshape(-1, width))
    return None


def _harmonics(prim: Any, count: int, path: Path, time: Any) -> Float[Tensor, "N K 3"]:
    """The colours up to degree 3; the schema's grey where a field has none."""
    space = _color_space(prim)
    if "lin" in space.lower():
        say(f"{path} has its colours in {shorten(space)!r}: read as sRGB, so they may look darker.")
    found = _rows(prim, COEFFICIENTS, 3, time)
    attribute = prim.GetAttribute(USD_DEGREE)
    degree = (attribute.Get() if attribute else None) or 0
    if found is None or not 0 <= degree or len(found) < count * sh_bases(degree):
        say(f"{path} has no colours for each of {prim.GetPath()}: they are grey.")
        return torch.zeros(count, 1, 3)
    if degree > MAX_DEGREE:
        say(f"{path} has colours of degree {degree}: the bands above 3 are left out.")
    bands = found[: count * sh_bases(degree)].reshape(count, sh_bases(degree), 3)
    return bands[:, : sh_bases(MAX_DEGREE)]


def _color_space(prim: Any) -> str:
    """The colour space that a prim, or one above it, declares; empty without any."""
    while prim:
        attribute = prim.GetAttribute("colorSpace:name")
        if attribute and attribute.Get():
            return str(attribute.Get())
        prim = prim.GetParent()
    return ""


def write_usd(splats: Splats, path: Path | str) -> None:
    """Write a stage with y up and a metre per unit: float32 throughout, colours of all degrees.

    `/Scene` turns the splats half about z, as glTF's node does. Opacities and standard deviations
    are stored themselves; when they are read again, opacities differ by at most 1e-7 and scales by
    1e-6. The suffix decides: `.usda` is text, `.usdz` a package, `.usd` and `.usdc` are binary.
    """
    path = Path(path)
    pxr = _library(path)
    refuse_faulty(splats, path)
    if not len(splats):
        raise StyleSplatError(
            f"Cannot export to {path}: there are no Gaussians, and a splat of USD has one at "
            "least. Export a .ply."
        )
    stage = _stage(splats, pxr)
    with atomic_path(path) as draft, _diagnostics(pxr):
        if path.suffix.lower() != USD_PACKAGE:
            _exported(stage, draft)
            return
        with TemporaryDirectory() as folder:
            inner = Path(folder) / f"{path.stem or 'splats'}.usdc"
            _exported(stage, inner)
            package = pxr.Sdf.ZipFileWriter.CreateNew(str(draft))
            package.AddFile(str(inner), inner.name)
            if not package.Save():
                raise OSError("the package could not be written")


def _exported(stage: Any, path: Path) -> None:
    if not stage.GetRootLayer().Export(str(path)):
        raise OSError("it could not be written")


def _stage(splats: Splats, pxr: Any) -> Any:
    """The stage in memory: its metadata, the transform to y up, and the field."""
    Gf, Usd, UsdGeom, UsdVol, Vt = pxr.Gf, pxr.Usd, pxr.UsdGeom, pxr.UsdVol, pxr.Vt
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().customLayerData = {"generator": "StyleSplat"}
    root = UsdGeom.Xform.Define(stage, "/Scene")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind("component")
    if splats.world_offset != ORIGIN:
        root.AddTranslateOp().Set(Gf.Vec3d(*(USD_TURNS["Y"] @ splats.world_offset + 0.0)))
    root.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(0, 0, 0, 1))

    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Scene/Splats")

    def vectors(rows: Float[Tensor, "M 3"]) -> Any:
        return Vt.Vec3fArray.FromNumpy(_array(rows))

    scales = splats.scales.exp().clamp(min=PACKED_SMALLEST)
    field.CreatePositionsAttr(vectors(splats.means))
    xyzw = unit_quats(splats.quats)[:, [1, 2, 3, 0]]
    field.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(_array(xyzw)))
    field.CreateScalesAttr(vectors(scales))
    field.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(_array(splats.opacities.sigmoid())))
    field.CreateRadianceSphericalHarmonicsDegreeAttr(splats.sh_degree)
    bands = torch.cat([splats.sh0, splats.shN], dim=1)
    coefficients = field.CreateRadianceSphericalHarmonicsCoefficientsAttr(
        vectors(bands.flatten(0, 1))
    )
    coefficients.SetMetadata("elementSize", bands.shape[1])
    reach = CUTOFF * scales.amax(dim=1, keepdim=True)
    box = [(splats.means - reach).amin(dim=0), (splats.means + reach).amax(dim=0)]
    field.CreateExtentAttr(vectors(torch.stack(box)))
    color_space = Usd.ColorSpaceAPI.Apply(field.GetPrim())
    color_space.CreateColorSpaceNameAttr(Gf.ColorSpaceNames.SRGBRec709)
    return stage


def _array(rows: Tensor) -> np.ndarray:
    return np.ascontiguousarray(rows.float().numpy())
