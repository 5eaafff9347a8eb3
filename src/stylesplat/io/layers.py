"""The stack of layers of a scene on disk, and the recipe that paints it again."""

import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import torch
from jaxtyping import Float
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError, error_context
from stylesplat.io.json_yaml import FilePath, convert_checked, read_json_as, write_json
from stylesplat.io.splats.splat_ply import FULL_BANDS, pad_bands
from stylesplat.io.tensors import GAUSSIANS, Declared, read_tensors, write_tensors
from stylesplat.options import MAX_INTENSITY
from stylesplat.scene.layers import (
    LAYER_LABEL,
    Blend,
    Layer,
    LayerKind,
    Source,
    recoloring,
    split_name,
)
from stylesplat.scene.objects import check_name_or_id
from stylesplat.scene.splats import Splats

STACK = "layers.json"
LAYERS = "layers"  # the folder of their tensors
RECIPE = "recipe.json"
# In the folder: no slashes, no dots
LAYER_FILE = r"\A[0-9]{2,5}-[A-Za-z0-9_-]{0,40}\.safetensors\Z"
MAX_NAME_PART = 40  # characters of an object's name in a file's
LEAST_RELIEF = -2.0  # of two bands of detail
UNIT = {"low": 0.0, "high": 1.0}
SCULPTURE = ("sculpture", "canvas_sculpture")
SURFELS = ("means", "quats", "scales", "opacities", "sh0", "shN")  # `canvas_*` in the file
# What `layers.json` has of a layer as it is
LAYER_PLAIN = ("object", "kind", "label", "blend", "strength", "form", "visible", "settings")
LAYER_PLAIN += ("features", "precision")
LAYER_AGAIN = "Style the scene again."
Word = Annotated[str, Meta(max_length=128, pattern=r"\A[\x20-\x7e]*\Z")]
Intensity = Annotated[float, Meta(ge=0, le=MAX_INTENSITY)]


class _Source(msgspec.Struct):
    path: FilePath | None = None
    sha256: Word | None = None


class LayerRecord(msgspec.Struct):
    """What `layers.json` has of a layer."""

    file: Annotated[str, Meta(pattern=LAYER_FILE)]
    object: str
    kind: LayerKind = "paint"
    label: Annotated[str, Meta(pattern=LAYER_LABEL)] = ""
    blend: Blend = "normal"
    strength: Intensity = 1.0
    form: Intensity = 0.0
    visible: bool = True
    styles: list[_Source] = []
    settings: dict[str, Any] = {}
    features: Word = "compact"
    weights: _Source | None = None
    precision: Word | None = None


class _Stack(msgspec.Struct):
    layers: Annotated[list[LayerRecord], Meta(min_length=1)]


def write_layers(layers: Sequence[Layer], folder: Path, before: Sequence[Layer] = ()) -> None:
    """Write the stack of a scene, bottom first, and its recipe into the scene's folder.

    `before` is the stack that the folder holds: files of layers that stay are not written again.
    An empty stack removes all files.
    """
    for layer in layers:
        check_name_or_id(layer.object)
    place = folder / LAYERS
    if place.is_symlink():
        place.unlink()  # its target is not ours
    old = folder / f"{LAYERS}.before"
    if place.exists():
        place.rename(old)
    files = {layer_identity(layer): file_name(n, layer) for n, layer in enumerate(before)}
    try:
        for number, layer in enumerate(layers):
            path, known = place / file_name(number, layer), files.get(layer_identity(layer))
            if known is not None and (old / known).is_file():
                path.parent.mkdir(exist_ok=True)
                (old / known).rename(path)
            else:
                write_layer(layer, path)
    finally:
        shutil.rmtree(old, ignore_errors=True)
    for name in (STACK, RECIPE):
        (folder / name).unlink(missing_ok=True)
    if layers:
        stack = [layer_record(layer, file_name(n, layer)) for n, layer in enumerate(layers)]
        write_json({"layers": stack}, folder / STACK)
        write_json(recipe_of(layers), folder / RECIPE)


def read_layers(folder: Path, count: int) -> tuple[Layer, ...]:
    """Read the stack of a scene whose base has `count` Gaussians."""
    stack = read_json_as(folder / STACK, _Stack, LAYER_AGAIN)
    with error_context(f"Cannot read {folder / STACK}"):
        for entry in stack.layers:
            check_name_or_id(entry.object)
            convert_checked(
                entry.settings.get("form", 0.0), Intensity, "form is wrong", LAYER_AGAIN
            )
        names = [(entry.object, entry.kind, entry.label) for entry in stack.layers]
        if len({*names}) < len(names):
            raise StyleSplatError(f"an object has two layers of a name. {LAYER_AGAIN}")
    return tuple(read_layer(folder / LAYERS, entry, count) for entry in stack.layers)


def file_name(number: int, layer: Layer) -> str:
    name = re.sub(r"[^A-Za-z0-9_-]", "_", layer.object)[:MAX_NAME_PART]
    return f"{number + 1:02}-{name}.safetensors"


def recipe_of(layers: Sequence[Layer]) -> dict[str, Any]:
    """The content of `recipe.json`: the objects, bottom layer first, and how they were painted.

    The settings of the first paint apply to all paint; each object lists those that differ.
    `intensity` and `form` are the values of now. A recolouring is an entry of its own.
    """
    shared = dict(next((each.settings for each in layers if each.kind == "paint"), {}))
    objects = [_recipe_entry(number, layer, shared) for number, layer in enumerate(layers)]
    return {"objects": objects, "settings": shared}


def as_tuple(values: Any) -> tuple[Any, ...]:
    """A value of a recipe that may be missing, single or a list."""
    if values is None:
        return ()
    return tuple(values) if isinstance(values, list | tuple) else (values,)


def _recipe_entry(number: int, layer: Layer, shared: Mapping[str, Any]) -> dict[str, Any]:
    weights = layer.weights
    paths, digests = ([getattr(s, name) for s in layer.styles] for name in ("path", "sha256"))
    intensity = layer.strength if layer.visible else 0.0
    shown = {} if layer.blend == "normal" else {"blend": layer.blend}
    file = f"{LAYERS}/{file_name(number, layer)}"
    if layer.kind == "edit":
        return {"name": layer.name, "layer": file, "intensity": intensity, **shown}
    if layer.mask is not None:
        shown["mask"] = file
    if layer.color_map is not None:
        picture = {"match": paths[0], "sha256": digests[0]} if paths else {}
        recolor = {**layer.settings, **picture}
        return {"name": layer.object, "recolor": recolor, "intensity": intensity, **shown}
    entry = {
        "name": layer.name,
        "style": paths[0] if len(paths) == 1 else paths,
        "sha256": digests[0] if len(digests) == 1 else digests,
        "intensity": intensity,
        "form": layer.form,
        "settings": {k: v for k, v in layer.settings.items() if k not in shared or v != shared[k]},
        "features": layer.features,
        "weights": weights and weights.path,
        "weights_sha256": weights and weights.sha256,
        **shown,
    }
    return entry | ({"precision": layer.precision} if layer.precision else {})


def layer_identity(layer: Layer) -> tuple[int, ...]:
    """Equal for two layers only if their files have the same content."""
    own = layer.rows, layer.sh0, layer.relief, layer.parents, layer.sculpture, layer.mask
    return tuple(id(tensor) for tensor in own)


def layer_record(layer: Layer, file: str) -> dict[str, Any]:
    """What `layers.json` has of a layer in a file; see `LayerRecord`."""
    return {
        "file": file,
        **{name: getattr(layer, name) for name in LAYER_PLAIN},
        "styles": [vars(source) for source in layer.styles],
        "weights": layer.weights and vars(layer.weights),
    }


def write_layer(layer: Layer, path: Path) -> None:
    write_tensors(layer_tensors(layer), path)


def layer_tensors(layer: Layer) -> dict[str, Tensor]:
    """The content of a layer's file; higher bands that are all 0 are left out."""
    mask = {} if layer.mask is None else {"mask": layer.mask}
    if layer.color_map is not None:
        palette = {} if layer.palette is None else {"palette": layer.palette}
        covered = {"rows": layer.rows, "shares": layer.shares, **mask}
        return {**covered, "color_map": layer.color_map, **palette}
    counts = [len(layer.rows), len(layer.parents)]
    own, new = layer.relief.split(counts)
    sculpture = {}
    if layer.sculpture is not None:
        sculpture = dict(zip(SCULPTURE, layer.sculpture.split(counts), strict=True))
    shN, surfels_shN = (
        pad_bands(each) if each.any() else each[:, :0] for each in (layer.shN, layer.surfels.shN)
    )
    every = {**layer.surfels.tensors(), "shN": surfels_shN}
    return {
        "rows": layer.rows,
        "shares": layer.shares,
        "sh0": layer.sh0,
        "shN": shN,
        "opacity_factors": layer.opacity_factors,
        "relief": own,
        "parents": layer.parents,
        "canvas_relief": new,
        "canvas_before": layer.surfels_sh0,
        **{f"canvas_{name}": every[name] for name in SURFELS},
        **sculpture,
        **mask,
    }


def _declared(count: int, kind: LayerKind) -> dict[str, Declared]:
    index = Declared(("R",), torch.int64, low=0, high=count - 1)
    row = Declared(("R",))
    share = replace(row, **UNIT)
    mask = replace(share, optional=True)
    covered = {"rows": replace(index, unique=True), "shares": share, "mask": mask}
    if kind == "recolour":
        palette = replace(share, shape=("K", 6), optional=True)
        return covered | {"color_map": Declared((3, 4)), "palette": palette}
    shapes = {name: each.shape[1:] for name, each in GAUSSIANS.items()}
    shapes["shN"] = ("canvas bands", 3)
    return {
        **covered,
        "sh0": replace(GAUSSIANS["sh0"], shape=("R", 1, 3)),
        "shN": replace(GAUSSIANS["shN"], shape=("R", "bands", 3)),
        "opacity_factors": replace(row, **UNIT),
        "relief": replace(row, low=LEAST_RELIEF),
        "parents": replace(index, shape=("C",)),
        "canvas_relief": replace(row, shape=("C",), low=LEAST_RELIEF),
        "canvas_before": replace(GAUSSIANS["sh0"], shape=("C", 1, 3)),
        **{
            name: replace(row, shape=(size,), low=LEAST_RELIEF, optional=True)
            for name, size in zip(SCULPTURE, "RC", strict=True)
        },
        **{
            f"canvas_{name}": replace(GAUSSIANS[name], shape=("C", *shapes[name]))
            for name in SURFELS
        },
    }


def read_layer(folder: Path, entry: LayerRecord, count: int) -> Layer:
    """Read a layer of a base of `count` Gaussians from its file in a folder."""
    path = folder / entry.file
    tensors = read_tensors(path, _declared(count, entry.kind), N=count)
    if entry.kind == "recolour":
        columns = {
            n: getattr(entry, n) for n in ("label", "blend", "strength", "visible", "settings")
        }
        styles = tuple(map(_source, entry.styles))
        return recoloring(entry.object, **tensors, **columns, styles=styles)
    for name in ("shN", "canvas_shN"):
        if tensors[name].shape[1] not in (0, FULL_BANDS):
            raise StyleSplatError(
                f"Cannot read {path}: {name} has a wrong number of bands. {LAYER_AGAIN}"
            )
        tensors[name] = pad_bands(tensors[name])
    own = ("rows", "shares", "sh0", "shN", "opacity_factors", "parents")
    columns: dict[str, Any] = {name: getattr(entry, name) for name in LAYER_PLAIN}
    columns |= {name: tensors[name] for name in own}
    surfels: dict[str, Any] = {name: tensors[f"canvas_{name}"] for name in SURFELS}
    sculpture = [tensors[name] for name in SCULPTURE if name in tensors]
    if len(sculpture) == 1:
        raise StyleSplatError(f"Cannot read {path}: it has half of a sculpture. {LAYER_AGAIN}")
    return Layer(
        **columns,
        surfels=Splats(**surfels),
        surfels_sh0=tensors["canvas_before"],
        relief=torch.cat([tensors["relief"], tensors["canvas_relief"]]),
        sculpture=torch.cat(sculpture) if sculpture else None,
        mask=tensors.get("mask"),
        styles=tuple(map(_source, entry.styles)),
        weights=entry.weights and _source(entry.weights),
    )


def read_layer_mask(path: Path, count: int, kind: LayerKind) -> Float[Tensor, " B"]:
    """The mask in the file of a layer, for all rows of a base of `count` Gaussians."""
    tensors = read_tensors(path, _declared(count, kind), N=count)
    if "mask" not in tensors:
        raise StyleSplatError(f"{path} holds no mask. Leave `mask` out of the recipe.")
    return torch.ones(count).index_copy(0, tensors["rows"], tensors["mask"])


def read_edit(path: Path, name: str, count: int, strength: float, blend: Blend) -> Layer:
    """Read the file of a layer that removes or recolours, of a base of `count` Gaussians."""
    object, label = split_name(name)
    entry = LayerRecord(path.name, object, "edit", label, blend, strength)
    return read_layer(path.parent, entry, count)


def _source(each: _Source) -> Source:
    return Source(Path(each.path) if each.path else None, each.sha256)
