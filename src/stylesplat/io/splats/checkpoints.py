"""Splats in training checkpoints: gsplat's `.pt`, nerfstudio's splatfacto `.ckpt`.

They are archives of tensors that a pickle lists. torch's weights-only loader reads them, which
makes tensors and plain containers and runs nothing; a file that needs more than that is refused.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from stylesplat.errors import join_names
from stylesplat.io.files import reason
from stylesplat.io.splats.splat_ply import BANDS, MAX_DEGREE
from stylesplat.io.tensors import GAUSSIANS, check_form
from stylesplat.progress import say
from stylesplat.scene.splats import Splats, sh0_from_rgb, sh_bases

TORCH_LIST = "data.pkl"  # the member of the archive that lists its tensors
RANK = re.compile(r"_rank\d+$")  # of the file of one GPU of several
SPLATFACTO = re.compile(r"_model\.(?:gauss_params\.)?")  # before the names of parameters
PARAMETERS = ("means", "quats", "scales", "opacities")


def read_checkpoint(path: Path | str) -> Splats:
    """Read the Gaussians of a checkpoint as they are, in the frame that they were trained in."""
    path = Path(path)
    content = _load(path)
    found = content.get("splats") if isinstance(content, Mapping) else None
    pipeline = content.get("pipeline") if isinstance(content, Mapping) else None
    if isinstance(found, Mapping):
        splats = _of_gsplat(found)
    elif isinstance(pipeline, Mapping):
        splats = _of_splatfacto(pipeline)
    else:
        keys = join_names([*content]) if isinstance(content, Mapping) else type(content).__name__
        raise ValueError(
            f"it is a file of PyTorch, but no checkpoint of gsplat or splatfacto ({keys})"
        )
    if RANK.search(path.stem):
        pattern = RANK.sub("_rank*", path.stem) + path.suffix
        others = sorted(each.name for each in path.parent.glob(pattern) if each != path)
        if others:
            say(f"{path} holds the Gaussians of one GPU alone; others are in {join_names(others)}.")
    return splats


def _load(path: Path) -> Any:
    try:
        return torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except Exception as error:  # torch.load raises half a dozen kinds
        if "Weights only load failed" in str(error):
            code = re.search(r"GLOBAL ([\w.]+)", str(error))
            what = f" ({code[1]:.60})" if code else ""
            raise ValueError(
                f"it holds more than tensors{what}, which could run code, so it is not loaded"
            ) from error
        raise ValueError(reason(error)) from error


def _of_gsplat(found: Mapping[str, Any]) -> Splats:
    """Parameters of gsplat's `simple_trainer`, whose names are ours."""
    if "features" in found and "sh0" not in found:
        raise ValueError("its colours come from an appearance network; train without --app_opt")
    return _checked({name: found.get(name) for name in GAUSSIANS})


def _of_splatfacto(pipeline: Mapping[str, Any]) -> Splats:
    """Parameters of nerfstudio's splatfacto; without higher bands colours are logits of RGB."""
    found = {
        SPLATFACTO.sub("", key): value
        for key, value in pipeline.items()
        if isinstance(key, str) and SPLATFACTO.match(key)
    }
    named = {name: found.get(name) for name in PARAMETERS}
    first, rest = found.get("features_dc"), found.get("features_rest")
    if isinstance(named["opacities"], Tensor) and named["opacities"].ndim == 2:
        named["opacities"] = named["opacities"][:, 0]
    if isinstance(first, Tensor) and isinstance(rest, Tensor) and rest.ndim == 3:
        first = first if rest.shape[1] else sh0_from_rgb(first.sigmoid())
        named |= {"sh0": first[:, None], "shN": rest}
    return _checked(named)


def _checked(found: Mapping[str, Any]) -> Splats:
    """Splats of these parameters; a ValueError unless their shapes fit each other."""
    missing = [name for name in GAUSSIANS if not isinstance(found.get(name), Tensor)]
    if missing:
        raise ValueError(f"it has no {missing[0]}, so no Gaussians")
    sizes = dict[str, int]()
    for name, declared in GAUSSIANS.items():  # of any precision; what a row holds is checked later
        check_form(name, found[name], replace(declared, dtype=found[name].dtype), sizes)
    degree = math.isqrt(sizes["bands"] + 1) - 1
    if sh_bases(degree) != sizes["bands"] + 1:
        raise ValueError(f"its {sizes['bands']} higher bands of colour fit no degree")
    if degree > MAX_DEGREE:
        say(f"Its colours are of degree {degree}: the bands above 3 are left out.")
    tensors = {name: found[name].detach().float() for name in GAUSSIANS}
    tensors["shN"] = tensors["shN"][:, : BANDS[-1]]
    return Splats(**{name: tensor.clone() for name, tensor in tensors.items()})
