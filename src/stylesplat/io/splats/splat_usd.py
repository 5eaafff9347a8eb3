"""Splats as OpenUSD's `ParticleField3DGaussianSplat` (UsdVol, since 26.03), by `usd-core`.

Its scales are standard deviations and its opacities shares, where PLY has logarithms and logits;
its harmonics are the INRIA code's, those of a Gaussian after each other.
"""

import signal
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.files import atomic_path
from stylesplat.io.splats import usd_trial
from stylesplat.io.splats.rotations import unit_quats
from stylesplat.io.splats.splat_ply import check_splats
from stylesplat.scene.frames import Frame, move_splats
from stylesplat.scene.splats import Splats

WRITTEN = (".usd", ".usdc", ".usda")
READ = (*WRITTEN, ".usdz")
HALF_TURN = torch.diag(torch.tensor([-1.0, -1.0, 1.0])).double()  # from y down to USD's y up
Z_UP = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]).double()  # and from its z up to y up
EVEN = 1e-4  # share by which a transform may stretch one axis more than another
SMALLEST, FINE = torch.finfo(torch.float32).tiny, 2.0**-25  # float32 is fine near 0, coarse near 1
AGAIN = "Export it again, or as .ply."


def write_usd(splats: Splats, path: Path | str) -> None:
    """Write USD (binary, or text for .usda): float32 throughout, colours of all degrees.

    The splats stay in their own frame; a transform states that USD's y is up.

    Raises:
        StyleSplatError: If usd-core is not installed, or the file cannot be written.
    """
    pxr = _library(path)
    stage = pxr.Usd.Stage.CreateInMemory()
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.y)
    prim = pxr.UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Splats").GetPrim()
    stage.SetDefaultPrim(prim)
    half_turn = torch.block_diag(HALF_TURN, torch.ones(1, 1).double())
    pxr.UsdGeom.Xformable(prim).AddTransformOp().Set(pxr.Gf.Matrix4d(*half_turn.flatten().tolist()))
    Vt, means = pxr.Vt, splats.means.numpy()
    bands = torch.cat([splats.sh0, splats.shN], dim=1)
    low, high = (means.min(axis=0), means.max(axis=0)) if len(means) else np.zeros((2, 3))
    columns = {
        "positions": Vt.Vec3fArray.FromNumpy(means),
        "orientations": Vt.QuatfArray.FromNumpy(unit_quats(splats.quats)[:, [1, 2, 3, 0]].numpy()),
        "scales": Vt.Vec3fArray.FromNumpy(splats.scales.exp().numpy()),
        "opacities": Vt.FloatArray.FromNumpy(torch.sigmoid(splats.opacities).numpy()),
        "radiance:sphericalHarmonicsDegree": splats.sh_degree,
        "radiance:sphericalHarmonicsCoefficients": Vt.Vec3fArray.FromNumpy(
            bands.flatten(0, 1).contiguous().numpy()
        ),
        "extent": Vt.Vec3fArray.FromNumpy(np.stack([low, high]).astype(np.float32)),
    }
    for name, value in columns.items():
        prim.GetAttribute(name).Set(value)
    with atomic_path(path) as temporary:
        stage.GetRootLayer().Export(str(temporary))


def read_usd(path: Path | str) -> Splats:
    """Read the splats of a USD file into PLY's axes.

    What transforms do to them is done, and the world is turned until y is down, as that of COLMAP,
    INRIA's code and `import`: a file that StyleSplat wrote comes back as it was. Several sets of
    splats are refused, as are files that refer to others.

    Raises:
        StyleSplatError: If usd-core is not installed; or the file is damaged, refers to others, has
            no splats or more than one set of them, or stretches them.
    """
    pxr = _library(path)
    _try_out(path)
    try:
        layer = pxr.Sdf.Layer.FindOrOpen(str(path))
        if layer is None:
            raise _refusal(path, "it is no USD file")
        layer.Reload()
        others = layer.GetCompositionAssetDependencies()
        if others:
            raise _refusal(path, f"it refers to other files, such as {brief(others[0])!r}")
        stage = pxr.Usd.Stage.Open(layer)
        kind = pxr.UsdVol.ParticleField3DGaussianSplat
        found = [prim for prim in stage.Traverse() if prim.IsA(kind)]
        if len(found) != 1:
            raise _refusal(path, f"it has {len(found) or 'no'} sets of splats")
        time = pxr.Usd.TimeCode.EarliestTime()
        world = pxr.UsdGeom.Xformable(found[0]).ComputeLocalToWorldTransform(time)
        z_up = pxr.UsdGeom.GetStageUpAxis(stage) == pxr.UsdGeom.Tokens.z
        splats = _splats(pxr, found[0], path)
    except (pxr.Tf.ErrorException, RuntimeError, TypeError, ValueError) as error:
        raise _refusal(path, f"it is damaged ({type(error).__name__})") from error
    check_splats(splats, path)
    frame = _frame(np.array(world), path, z_up=z_up)
    return splats if frame is None else check_splats(move_splats(splats, frame), path)


def _try_out(path: Path | str) -> None:
    """Refuse a file of which OpenUSD's library dies, having had another process read it."""
    command = [sys.executable, "-P", str(usd_trial.__file__), str(path)]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode == -signal.SIGKILL:
        raise _refusal(path, "it takes more memory than there is")
    if done.returncode < 0:
        raise _refusal(path, "it is damaged (OpenUSD's library breaks down on it)")


def _splats(pxr: Any, prim: Any, path: Path | str) -> Splats:
    """Of a prim, in its own frame."""
    time = pxr.Usd.TimeCode.EarliestTime()

    def values(name: str) -> Any:
        return prim.GetAttribute(name).Get(time)

    means = _column(values, "positions", 3, path)
    opacities = _column(values, "opacities", 1, path)[:, 0].double()
    scales = _column(values, "scales", 3, path)
    colors = _column(values, "radiance:sphericalHarmonicsCoefficients", 3, path)
    bands, rest = divmod(len(colors), max(len(means), 1))
    if bands not in (1, 4, 9, 16, 25) or rest:
        raise _refusal(path, f"it has {len(colors)} harmonics of {len(means)} Gaussians")
    if (scales < 0).any() or not ((opacities >= 0) & (opacities <= 1)).all():
        raise _refusal(path, "it has negative sizes, or opacities beyond 0 and 1")
    colors = colors.unflatten(0, (len(means), bands))[:, :16]
    return Splats(
        means=means,
        quats=_column(values, "orientations", 4, path)[:, [3, 0, 1, 2]],
        scales=scales.clamp(min=SMALLEST).log(),
        opacities=opacities.clamp(SMALLEST, 1 - FINE).logit().float(),
        sh0=colors[:, :1].contiguous(),
        shN=colors[:, 1:].contiguous(),
    )


def _column(values: Any, name: str, width: int, path: Path | str) -> Float[Tensor, "M D"]:
    """An attribute in single precision, or else its other form in half."""
    for each in (name, f"{name}h"):
        found = values(each)
        if found is not None and len(found):
            rows = np.array(found, dtype=np.float32).reshape(len(found), -1)
            if rows.shape[1] == width:
                return torch.from_numpy(rows)
    raise _refusal(path, f"its splats have no {name}")


def _frame(world: np.ndarray, path: Path | str, *, z_up: bool) -> Frame | None:
    """From the splats' own frame to the world with y down; None if they are the same."""
    matrix = torch.from_numpy(world).double().T  # USD's vectors are rows
    turn = HALF_TURN @ (Z_UP if z_up else torch.eye(3).double())
    linear, shift = turn @ matrix[:3, :3], turn @ matrix[:3, 3]
    scale = float(torch.linalg.det(linear).abs()) ** (1 / 3)
    rotation = linear / max(scale, 1e-30)
    error = (rotation @ rotation.T - torch.eye(3).double()).abs().max()
    if not error < EVEN or torch.linalg.det(linear) <= 0:
        raise _refusal(path, "its transform stretches or mirrors the splats")
    same = torch.equal(linear, torch.eye(3).double()) and not shift.any()
    return None if same else Frame(rotation, scale, shift)


def _library(path: Path | str) -> Any:
    """OpenUSD's modules."""
    if find_spec("pxr") is None:
        raise StyleSplatError(
            f"USD files such as {path} need the package usd-core. Install it with `pip install "
            "'stylesplat[usd]'`, or use a .ply or .glb."
        )
    names = ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdVol", "Vt")
    return SimpleNamespace(**{name: import_module(f"pxr.{name}") for name in names})


def _refusal(path: Path | str, fault: str) -> StyleSplatError:
    return StyleSplatError(f"Cannot read {path} as USD: {fault}. {AGAIN}")
