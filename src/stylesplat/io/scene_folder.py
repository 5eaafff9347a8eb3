"""Scenes on disk: a folder with all that the verbs after `train` need."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path, claim_directory, read_json, write_json
from stylesplat.io.splats.splat_ply import pad_bands, read_splat_ply, write_splat_ply
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Classifier, Splats

SCENE = "scene.json"
SPLATS = "splats.ply"
IDENTITIES = "identities.safetensors"
CAMERAS = "cameras.json"
OBJECTS = "objects.json"
PICKS = "picks.safetensors"
METRICS = "metrics.json"
BASE_COLORS = "base_colors.safetensors"
STYLE_COLORS = "style_colors.safetensors"
UNSPLIT = "unsplit.safetensors"
RECIPE = "recipe.json"
VERSION = 1  # of the folder's layout


@dataclass(frozen=True)
class Unsplit:
    """What it takes to undo a split, besides the colours before."""

    count: int
    """How many Gaussians there were; what follows them is new."""
    rows: Int[Tensor, " R"]
    """Those that were split."""
    scales: Float[Tensor, "R 3"]
    """Theirs before."""
    opacities: Float[Tensor, " R"]
    """Theirs before."""


@dataclass(frozen=True)
class Scene:
    """Splats with all that is known about them."""

    splats: Splats
    """Of degree 3 once they come from disk."""
    cameras: Cameras
    """All cameras of the capture, at the photos' full size."""
    picks: dict[str, Bool[Tensor, " N"]] = field(default_factory=dict)
    """The Gaussians of each named object."""
    objects: dict[str, dict[str, Any]] = field(default_factory=dict)
    """How each object was picked."""
    info: dict[str, Any] = field(default_factory=dict)
    """Where the scene comes from: capture, held-out views, settings, timings, versions."""
    metrics: dict[str, Any] = field(default_factory=dict)
    """What was measured."""
    base_colors: dict[str, Float[Tensor, "N _ 3"]] | None = None
    """`sh0` and `shN` before styling; None if the scene is not styled."""
    style_colors: dict[str, Float[Tensor, "N _ 3"]] | None = None
    """`sh0` and `shN` at full intensity; None if the scene is not styled."""
    unsplit: Unsplit | None = None
    """The shapes of Gaussians that were split before styling; None if none were."""
    recipe: dict[str, Any] | None = None
    """How the scene was styled; None if it is not."""


def write_scene(scene: Scene, path: Path | str, *, overwrite: bool = False) -> None:
    """Write a scene, whole or not at all.

    Raises:
        StyleSplatError: If the folder holds something and `overwrite` is off, or it cannot be
            written.
    """
    with claim_directory(path, overwrite=overwrite, marker=SCENE) as folder:
        write_splat_ply(scene.splats, folder / SPLATS)
        _write_identities(scene.splats, folder)
        _write_cameras(scene.cameras, folder)
        _write_colors(scene.base_colors, folder / BASE_COLORS)
        _write_colors(scene.style_colors, folder / STYLE_COLORS)
        if scene.unsplit is not None:
            tensors = {**vars(scene.unsplit), "count": torch.tensor(scene.unsplit.count)}
            _write_tensors(tensors, folder / UNSPLIT)
        if scene.recipe is not None:
            write_json(scene.recipe, folder / RECIPE)
        write_json({"version": VERSION, **scene.info}, folder / SCENE)
        update_scene(folder, picks=scene.picks, objects=scene.objects, metrics=scene.metrics)


def update_scene(
    path: Path | str,
    *,
    picks: dict[str, Bool[Tensor, " N"]] | None = None,
    objects: dict[str, dict[str, Any]] | None = None,
    metrics: dict[str, Any] | None = None,
) -> None:
    """Replace the named objects or the metrics of a scene and leave the rest; None leaves too.

    Raises:
        StyleSplatError: If the folder is no scene or cannot be written.
    """
    folder = _scene_folder(path)
    if picks is not None:
        _write_tensors(picks, folder / PICKS)
    if objects is not None:
        write_json(objects, folder / OBJECTS)
    if metrics is not None:
        write_json(metrics, folder / METRICS)


def update_colors(scene: Scene, path: Path | str) -> None:
    """Replace the colours of a styled scene, their recipe and metrics, and leave the rest.

    Raises:
        StyleSplatError: If the folder is no scene or cannot be written.
    """
    folder = _scene_folder(path)
    write_splat_ply(scene.splats, folder / SPLATS)
    write_json(scene.recipe or {}, folder / RECIPE)
    update_scene(folder, metrics=scene.metrics)


def read_scene(path: Path | str) -> Scene:
    """Read a scene.

    Raises:
        StyleSplatError: If the folder is no scene, or a file of it is missing, damaged, or made
            for other splats.
    """
    folder = _scene_folder(path)
    info = read_json(folder / SCENE)
    if info.pop("version", None) != VERSION:
        raise StyleSplatError(
            f"{folder / SCENE} is not of version {VERSION}. Read it with the StyleSplat that made "
            "it, or train again."
        )
    splats = _read_identities(read_splat_ply(folder / SPLATS), folder)
    count = len(splats)
    recipe = folder / RECIPE
    return Scene(
        splats=splats,
        cameras=_read_cameras(folder / CAMERAS),
        picks=_read_tensors(folder / PICKS, count),
        objects=_read_objects(folder / OBJECTS),
        info=info,
        metrics=read_json(folder / METRICS),
        base_colors=_read_colors(folder / BASE_COLORS, count),
        style_colors=_read_colors(folder / STYLE_COLORS, count),
        unsplit=_read_unsplit(folder / UNSPLIT),
        recipe=read_json(recipe) if recipe.exists() else None,
    )


def _read_objects(path: Path) -> dict[str, dict[str, Any]]:
    objects = read_json(path)
    if not all(isinstance(how, dict) for how in objects.values()):
        raise StyleSplatError(f"Cannot read {path}: expected an object per name. Select again.")
    return objects


def _scene_folder(path: Path | str) -> Path:
    folder = Path(path)
    if not (folder / SCENE).is_file():
        raise StyleSplatError(
            f"{folder} is not a scene: it has no {SCENE}. "
            f"Make one with `stylesplat train CAPTURE -o {folder}`."
        )
    return folder


def _write_identities(splats: Splats, folder: Path) -> None:
    if splats.identities is None or splats.classifier is None:
        return
    tensors = {
        "identities": splats.identities,
        "weight": splats.classifier.weight,
        "bias": splats.classifier.bias,
        "ids": torch.tensor(splats.classifier.ids),
    }
    if splats.confidence is not None:
        tensors["confidence"] = splats.confidence
    _write_tensors(tensors, folder / IDENTITIES)


def _read_identities(splats: Splats, folder: Path) -> Splats:
    path = folder / IDENTITIES
    if not path.exists():
        return splats
    tensors = _load_tensors(path)
    missing = {"identities", "weight", "bias", "ids"} - tensors.keys()
    if missing:
        raise StyleSplatError(f"Cannot read {path}: it has no {min(missing)}. Train again.")
    classifier = Classifier(tensors["weight"], tensors["bias"], tuple(tensors["ids"].tolist()))
    rows = {name: tensors[name] for name in ("identities", "confidence") if name in tensors}
    _check_rows(rows, path, len(splats))
    return replace(splats, **rows, classifier=classifier)


def _write_cameras(cameras: Cameras, folder: Path) -> None:
    """As numbers of 64 bits, which hold those of 32 exactly."""
    rows = zip(
        *(cameras.names, cameras.sizes.tolist(), cameras.viewmats.tolist(), cameras.Ks.tolist()),
        strict=True,
    )
    keys = ("name", "size", "viewmat", "K")
    dtype = torch.promote_types(cameras.viewmats.dtype, cameras.Ks.dtype)
    write_json(
        {
            "dtype": str(dtype).removeprefix("torch."),
            "cameras": [dict(zip(keys, row, strict=True)) for row in rows],
        },
        folder / CAMERAS,
    )


def _read_cameras(path: Path) -> Cameras:
    content = read_json(path)
    try:
        dtype = {"float32": torch.float32, "float64": torch.float64}[content["dtype"]]
        rows = content["cameras"]
        return Cameras(
            viewmats=torch.tensor([row["viewmat"] for row in rows], dtype=dtype).reshape(-1, 4, 4),
            Ks=torch.tensor([row["K"] for row in rows], dtype=dtype).reshape(-1, 3, 3),
            sizes=torch.tensor([row["size"] for row in rows]).reshape(-1, 2),
            names=tuple(row["name"] for row in rows),
        )
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise StyleSplatError(f"Cannot read {path}: {reason}. Train again.") from error


def _write_tensors(tensors: dict[str, Tensor], path: Path) -> None:
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    with atomic_path(path) as temporary:
        temporary.write_bytes(safetensors.torch.save(whole))


def _write_colors(colors: dict[str, Tensor] | None, path: Path) -> None:
    if colors is not None:
        _write_tensors({**colors, "shN": pad_bands(colors["shN"])}, path)


def _read_colors(path: Path, count: int) -> dict[str, Tensor] | None:
    return _read_tensors(path, count) if path.exists() else None


def _read_unsplit(path: Path) -> Unsplit | None:
    if not path.exists():
        return None
    tensors = _load_tensors(path)
    try:
        return Unsplit(count=int(tensors.pop("count")), **tensors)
    except (KeyError, TypeError) as error:
        raise StyleSplatError(f"Cannot read {path}: {error}. Style the scene again.") from error


def _load_tensors(path: Path) -> dict[str, Tensor]:
    try:
        return safetensors.torch.load(path.read_bytes())
    except (OSError, safetensors.SafetensorError) as error:
        raise StyleSplatError(f"Cannot read {path}: {error}. Make the scene again.") from error


def _read_tensors(path: Path, count: int) -> dict[str, Tensor]:
    """Tensors with a row per Gaussian."""
    tensors = _load_tensors(path)
    _check_rows(tensors, path, count)
    return tensors


def _check_rows(tensors: dict[str, Tensor], path: Path, count: int) -> None:
    for name, tensor in tensors.items():
        if tensor.shape[:1] != (count,):
            raise StyleSplatError(
                f"Cannot read {path}: {name} has the shape {list(tensor.shape)}, but there are "
                f"{count} Gaussians. The files belong to different scenes."
            )
