"""Scenes on disk: a folder with all that the verbs after `train` need."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError, within
from stylesplat.io.folders import claim_directory, revised_directory
from stylesplat.io.json_files import fitting, read_json, write_json
from stylesplat.io.painted_files import read_painted, write_painted
from stylesplat.io.recovery import settled
from stylesplat.io.splats.splat_ply import read_splat_ply, write_splat_ply
from stylesplat.io.tensors import check_rows, load_tensors, read_rows, write_tensors
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Classifier, Splats

SCENE = "scene.json"
SPLATS = "splats.ply"
IDENTITIES = "identities.safetensors"
CAMERAS = "cameras.json"
OBJECTS = "objects.json"
PICKS = "picks.safetensors"
METRICS = "metrics.json"
AGAIN = "Train again."
VERSION = 1  # of the folder's layout


def save(scene: Scene, path: Path | str, *, overwrite: bool = False) -> None:
    """Write a scene, whole or not at all.

    Args:
        scene: What to write.
        path: The folder to make.
        overwrite: Whether a scene there may be replaced.

    Raises:
        StyleSplatError: If the folder holds something and `overwrite` is off, or it cannot be
            written.
    """
    with claim_directory(path, overwrite=overwrite, marker=SCENE) as folder:
        _write(scene, folder)


def revise(before: Scene, after: Scene, path: Path | str) -> None:
    """Write what differs between two scenes into the folder of the first, all of it or nothing.

    Args:
        before: As it is in the folder.
        after: As it is to be.
        path: The folder; other files in it stay.

    Raises:
        StyleSplatError: If the folder is no scene or cannot be written.
    """
    with revised_directory(_scene_folder(path)) as folder:
        _write(after, folder, before)


def open(path: Path | str) -> Scene:
    """Read a scene.

    Raises:
        StyleSplatError: If the folder is no scene, or a file of it is missing, damaged, or made
            for other splats.
    """
    return settled(path, _read)


def _read(path: Path) -> Scene:
    folder = _scene_folder(path)
    info = read_json(folder / SCENE)
    if info.pop("version", None) != VERSION:
        raise StyleSplatError(
            f"{folder / SCENE} is not of version {VERSION}. Read it with the StyleSplat that made "
            "it, or train again."
        )
    splats = _read_identities(read_splat_ply(folder / SPLATS), folder)
    with within(f"Cannot read {folder / SCENE}"):
        capture = fitting(info.pop("capture", None), str | None, "capture is wrong", AGAIN)
        held_out = fitting(
            info.pop("test_views", []), tuple[str, ...], "test_views is wrong", AGAIN
        )
        downscale = _taken_downscale(info)
    picks = read_rows(folder / PICKS, len(splats))
    painted = read_painted(folder, picks, len(splats))
    return Scene(
        splats=splats,
        cameras=_read_cameras(folder / CAMERAS),
        held_out=held_out,
        downscale=downscale,
        objects=_read_objects(folder / OBJECTS, picks),
        painted=painted,
        path=folder,
        capture=Path(capture) if capture else None,
        info=info,
        metrics=read_json(folder / METRICS),
    )


def _write(scene: Scene, folder: Path, before: Scene | None = None) -> None:
    """Write what differs from what the folder holds already; everything if that is nothing."""

    def differs(*names: str) -> bool:
        return before is None or any(getattr(scene, n) is not getattr(before, n) for n in names)

    if differs("splats"):
        write_splat_ply(scene.splats, folder / SPLATS)
        _write_identities(scene.splats, folder)
    if differs("cameras"):
        _write_cameras(scene.cameras, folder)
    if differs("objects"):
        picks = {name: each.picked for name, each in scene.objects.items()}
        write_tensors(picks, folder / PICKS)
        write_json({name: each.how for name, each in scene.objects.items()}, folder / OBJECTS)
    if differs("painted"):
        write_painted(scene.painted, folder)
    if differs("metrics"):
        write_json(scene.metrics, folder / METRICS)
    if differs("info", "capture", "held_out", "downscale"):
        write_json(_info(scene), folder / SCENE)


def _info(scene: Scene) -> dict[str, Any]:
    settings = {**scene.info.get("settings", {}), "downscale": scene.downscale}
    return {
        **scene.info,
        "version": VERSION,
        "capture": scene.capture,
        "test_views": scene.held_out,
        "settings": settings,
    }


def _taken_downscale(info: dict[str, Any]) -> float:
    """The downscale, which a file keeps among the settings, taken from there."""
    settings = info.pop("settings", {})
    if not isinstance(settings, dict):
        raise StyleSplatError("settings must be KEY: VALUE. Train again.")
    value = settings.pop("downscale", 1.0)
    if settings:
        info["settings"] = settings
    if not isinstance(value, int | float) or not value > 0:
        raise StyleSplatError(f"downscale is {value!r}, not a number above 0. Train again.")
    return float(value)


def _read_objects(path: Path, picks: Mapping[str, Tensor]) -> dict[str, SceneObject]:
    hows = read_json(path)
    for name, how in hows.items():
        if not isinstance(how, dict):
            raise StyleSplatError(f"Cannot read {path}: expected an object per name. Select again.")
        if name not in picks:
            raise StyleSplatError(f"{path} names {name!r}, but {PICKS} does not. Select it again.")
    return {name: SceneObject(picks[name], how) for name, how in hows.items()}


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
        (folder / IDENTITIES).unlink(missing_ok=True)  # an earlier state's
        return
    tensors = {
        "identities": splats.identities,
        "weight": splats.classifier.weight,
        "bias": splats.classifier.bias,
        "ids": torch.tensor(splats.classifier.ids),
    }
    if splats.confidence is not None:
        tensors["confidence"] = splats.confidence
    write_tensors(tensors, folder / IDENTITIES)


def _read_identities(splats: Splats, folder: Path) -> Splats:
    path = folder / IDENTITIES
    if not path.exists():
        return splats
    tensors = load_tensors(path)
    missing = {"identities", "weight", "bias", "ids"} - tensors.keys()
    if missing:
        raise StyleSplatError(f"Cannot read {path}: it has no {min(missing)}. Train again.")
    classifier = Classifier(tensors["weight"], tensors["bias"], tuple(tensors["ids"].tolist()))
    rows = {name: tensors[name] for name in ("identities", "confidence") if name in tensors}
    check_rows(rows, path, len(splats))
    return replace(splats, **rows, classifier=classifier)


def _write_cameras(cameras: Cameras, folder: Path) -> None:
    """As numbers of 64 bits, which hold those of 32 exactly."""
    dtype = torch.promote_types(cameras.viewmats.dtype, cameras.Ks.dtype)
    rows = [
        {
            "name": name,
            "size": cameras.sizes[row].tolist(),
            "viewmat": cameras.viewmats[row].tolist(),
            "K": cameras.Ks[row].tolist(),
        }
        for row, name in enumerate(cameras.names)
    ]
    content = {"dtype": str(dtype).removeprefix("torch."), "cameras": rows}
    write_json(content, folder / CAMERAS)


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
