"""Scenes on disk: a folder with all that the verbs after `train` need."""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta
from torch import Tensor

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.cameras_file import read_cameras, write_cameras
from stylesplat.io.declared import PICKED
from stylesplat.io.folders import claim_directory, revised_directory
from stylesplat.io.identities_file import with_identities, write_identities
from stylesplat.io.json_files import (
    MAX_JSON,
    FilePath,
    PhotoName,
    fitting,
    read_json,
    write_json,
)
from stylesplat.io.kinds import no_scene
from stylesplat.io.layer_files import STACK, read_layers, write_layers
from stylesplat.io.recovery import settled
from stylesplat.io.splats.splat_ply import pad_bands, read_splat_ply, splat_fault, write_splat_ply
from stylesplat.io.tensors import read_named, write_tensors
from stylesplat.progress import say
from stylesplat.scene.labels import MAX_ID
from stylesplat.scene.layer import Layer
from stylesplat.scene.scene import Scene, SceneObject, check_name, name_fault
from stylesplat.scene.splats import Splats

SCENE = "scene.json"
SPLATS = "splats.ply"  # what it looks like
BASE = "base.ply"  # what lies beneath the layers
IDENTITIES = "identities.safetensors"
CAMERAS = "cameras.json"
OBJECTS = "objects.json"
PICKS = "picks.safetensors"
METRICS = "metrics.json"
AGAIN = "Train again."
VERSION = 2  # of the folder's layout
# What version 1 had of paintings
OF_OLD = tuple(
    f"{name}.safetensors"
    for name in ("base_colors", "style_colors", "opacities", "unsplit", "paintings")
)


class _Settings(msgspec.Struct):
    """Those that are used again; it may have others."""

    downscale: Annotated[float, Meta(ge=1, le=0xFFFF)] = 1.0


class _Info(msgspec.Struct):
    """What `scene.json` has besides the version; it may say more."""

    capture: FilePath | None = None
    capture_relative: FilePath | None = None  # from the scene's folder; earlier ones have none
    test_views: tuple[PhotoName, ...] = ()
    settings: _Settings = msgspec.field(default_factory=_Settings)
    fits: tuple[Literal["colors", "pose"], ...] = ()  # what each photo has of its own


class _How(msgspec.Struct):
    """Of an object, what is used again of how it was chosen."""

    ids: list[Annotated[int, Meta(ge=0, le=MAX_ID)]] = []


class _Metrics(msgspec.Struct):
    """What is used again of what was measured: that of the scene before it was styled."""

    train: dict[str, Any] = {}


@check_arguments
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
        _write(scene, folder, Path(path))


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
        _write(after, folder, Path(path), before)


@check_arguments
def open(path: Path | str) -> Scene:
    """Read a scene.

    Raises:
        StyleSplatError: If the folder is no scene, or a file of it is missing, damaged, or made
            for other splats.
    """
    return settled(path, partial(_read, bands=True))


def open_without_bands(path: Path | str) -> Scene:
    """Read a scene without the higher bands of colour: most of it, but needed to draw it alone.

    Raises:
        StyleSplatError: As `open` does.
    """
    return settled(path, partial(_read, bands=False))


def _read(path: Path, *, bands: bool) -> Scene:
    folder = _scene_folder(path)
    declared, info = _read_info(folder / SCENE)
    splats = with_identities(_read_gaussians(folder / SPLATS, bands), folder / IDENTITIES)
    picks = read_named(folder / PICKS, PICKED, N=len(splats))
    base, layers = _read_stack(folder, splats, bands)
    return Scene(
        splats=splats,
        cameras=read_cameras(folder / CAMERAS),
        held_out=declared.test_views,
        downscale=declared.settings.downscale,
        objects=_read_objects(folder / OBJECTS, picks),
        base=base,
        layers=layers,
        path=folder,
        capture=_found_capture(declared, folder),
        info=info,
        metrics=_read_metrics(folder / METRICS),
    )


def capture_of(folder: Path) -> Path | None:
    """The folder of a scene's photos, as `Scene.capture` has it, without reading the scene.

    Raises:
        StyleSplatError: If what says it is missing or damaged.
    """
    return _found_capture(_read_info(folder / SCENE)[0], folder)


def _found_capture(declared: _Info, folder: Path) -> Path | None:
    """Where the photos were, or where they are if they were moved together with the scene."""
    if declared.capture is None:
        return None
    there = Path(declared.capture)
    if declared.capture_relative is None or there.is_dir():
        return there
    moved = Path(os.path.normpath(folder.resolve() / declared.capture_relative))
    return moved if moved.is_dir() else there


def _read_gaussians(path: Path, bands: bool) -> Splats:
    """Of degree 3, as they were written, or of none."""
    splats = read_splat_ply(path, bands=bands)
    if not len(splats):
        raise StyleSplatError(f"Cannot read {path}: there are no Gaussians. {AGAIN}")
    return replace(splats, shN=pad_bands(splats.shN)) if bands else splats


def _read_stack(
    folder: Path, splats: Splats, bands: bool
) -> tuple[Splats | None, tuple[Layer, ...]]:
    """The splat beneath the layers, and these; None and none if there are none."""
    if (folder / OF_OLD[0]).exists():
        say(
            f"{folder} was written by an earlier StyleSplat: its paint stays, but cannot be undone "
            "or adjusted."
        )
    if not (folder / STACK).exists():
        return None, ()
    base = _read_gaussians(folder / BASE, bands)
    layers, count = read_layers(folder, len(base)), len(base)
    if len(splats) != count + sum(len(each.parents) for each in layers if each.is_shown):
        raise StyleSplatError(
            f"Cannot read {folder / BASE}: it and the layers do not make up the {len(splats):,} "
            f"Gaussians of {SPLATS}: the files belong to different scenes. {AGAIN}"
        )
    own = {n: getattr(splats, n) for n in ("identities", "confidence")}
    own = {name: tensor if tensor is None else tensor[:count] for name, tensor in own.items()}
    return replace(base, **own, classifier=splats.classifier), layers


def _read_metrics(path: Path) -> dict[str, Any]:
    metrics = read_json(path, most=MAX_JSON)
    fitting(metrics, _Metrics, f"Cannot read {path}", AGAIN)
    return metrics


def _write(scene: Scene, folder: Path, place: Path, before: Scene | None = None) -> None:
    """Write what differs from what the folder holds already; everything if that is nothing.

    It is to lie at `place`.
    """

    def differs(*names: str) -> bool:
        return before is None or any(getattr(scene, n) is not getattr(before, n) for n in names)

    if differs("splats"):
        fault = splat_fault(scene.splats) if len(scene.splats) else "there are no Gaussians"
        if fault:
            raise StyleSplatError(f"Cannot save the scene: {fault}. Remove what is wrong.")
        write_splat_ply(scene.splats, folder / SPLATS)
        write_identities(scene.splats, folder / IDENTITIES)
    if differs("cameras"):
        write_cameras(scene.cameras, folder / CAMERAS)
    if differs("objects"):
        for name in scene.objects:
            check_name(name)
        picks = {name: each.picked for name, each in scene.objects.items()}
        write_tensors(picks, folder / PICKS)
        write_json({name: each.how for name, each in scene.objects.items()}, folder / OBJECTS)
    if differs("base"):
        (folder / BASE).unlink(missing_ok=True)
        if scene.base is not None:
            write_splat_ply(scene.base, folder / BASE)
    if differs("layers"):
        write_layers(scene.layers, folder, before.layers if before else ())
    for name in OF_OLD:
        (folder / name).unlink(missing_ok=True)
    if differs("metrics"):
        write_json(scene.metrics, folder / METRICS)
    old = before is not None and read_json(folder / SCENE, most=MAX_JSON).get("version") != VERSION
    if old or differs("info", "capture", "held_out", "downscale"):
        write_json(_info(scene, place), folder / SCENE)


def _info(scene: Scene, place: Path) -> dict[str, Any]:
    settings = {**scene.info.get("settings", {}), "downscale": scene.downscale}
    relative = {}
    if scene.capture is not None:
        with suppress(ValueError):  # on another drive of Windows
            relative["capture_relative"] = os.path.relpath(scene.capture.resolve(), place.resolve())
    return {
        **scene.info,
        "version": VERSION,
        "capture": scene.capture,
        **relative,
        "test_views": scene.held_out,
        "settings": settings,
    }


def _read_info(path: Path) -> tuple[_Info, dict[str, Any]]:
    """What scene.json declares, and what else it says."""
    content = read_json(path, most=MAX_JSON)
    if content.pop("version", None) not in (1, VERSION):
        raise StyleSplatError(
            f"{path} is not of version 1 or {VERSION}. Read it with the StyleSplat that made it, "
            "or train again."
        )
    declared = fitting(content, _Info, f"Cannot read {path}", AGAIN)
    settings = content.pop("settings", {})
    settings.pop("downscale", None)
    own = ("capture", "capture_relative", "test_views")
    others = {key: value for key, value in content.items() if key not in own}
    return declared, others | ({"settings": settings} if settings else {})


def _read_objects(path: Path, picks: Mapping[str, Tensor]) -> dict[str, SceneObject]:
    hows = read_json(path, most=MAX_JSON)
    fitting(hows, dict[str, _How], f"Cannot read {path}", "Select again.")
    for name in hows:
        fault = name_fault(name)
        if fault:
            raise StyleSplatError(
                f"Cannot read {path}: no object is called {brief(name)!r}, for {fault}. "
                "Select it again."
            )
        if name not in picks:
            raise StyleSplatError(f"{path} names {name!r}, but {PICKS} does not. Select it again.")
    return {name: SceneObject(picks[name], how) for name, how in hows.items()}


def _scene_folder(path: Path | str) -> Path:
    folder = Path(path)
    if not (folder / SCENE).is_file():
        raise no_scene(folder)
    return folder
