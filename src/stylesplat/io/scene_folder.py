"""Scenes on disk: a folder with all that the verbs after `train` need."""

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import torch
from msgspec import Meta

from stylesplat.errors import StyleSplatError, shell_command, shorten
from stylesplat.io.atomic import atomic_folder, revise_folder
from stylesplat.io.cameras import read_cameras, write_cameras
from stylesplat.io.json_yaml import (
    MAX_JSON,
    FilePath,
    PhotoName,
    convert_checked,
    read_json,
    write_json,
)
from stylesplat.io.kinds import CAMERAS, SCENE, find_capture, wrong_kind_error
from stylesplat.io.layers import LAYERS, STACK, read_layers, write_layers
from stylesplat.io.splats.splat_ply import pad_bands, read_splat_ply, splat_fault, write_splat_ply
from stylesplat.io.tensors import (
    CLASSIFIER_IDS,
    IDENTITIES,
    PICKED,
    TENSOR_CLASSIFIER,
    Declared,
    read_tensors,
    write_tensors,
)
from stylesplat.options import check_arguments
from stylesplat.progress import say
from stylesplat.scene.objects import SceneObject, check_name, name_fault
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.scene.splats import Classifier, Splats
from stylesplat.scene.world_offset import LARGEST_POSITION, ORIGIN, Offset

SCENE_SPLATS = "splats.ply"  # what the scene looks like
BASE = "base.ply"  # what lies beneath the layers
IDENTITY_FILE = "identities.safetensors"
OBJECTS = "objects.json"
PICKS = "picks.safetensors"
METRICS = "metrics.json"
SCENE_AGAIN = "Train again."
COMPARED, SAME = 1000, 1e-3  # rows of splats.ply; relative differences that other processors make
SCENE_VERSION = 2  # of the folder's layout
VERSION_1_FILES = tuple(  # what version 1 held of paintings
    f"{name}.safetensors"
    for name in ("base_colors", "style_colors", "opacities", "unsplit", "paintings")
)
IDENTITY_TENSORS = {
    "identities": IDENTITIES,
    **TENSOR_CLASSIFIER,
    "ids": CLASSIFIER_IDS,
    "confidence": Declared(("N",), low=0, high=1.001, optional=True),  # a share, and rounding
}
CONTENT = (SCENE, SCENE_SPLATS, BASE, STACK, IDENTITY_FILE, CAMERAS, OBJECTS, PICKS)
# Keys of `objects.json` that have no list of one item, and the types of their items
ALONE = {"text": str, "box3d": list, "sphere": list}
ATTEMPTS = 5  # at reading a folder that others change; each takes seconds, and so does a change


_Coordinate = Annotated[float, Meta(ge=-LARGEST_POSITION, le=LARGEST_POSITION)]


class _Settings(msgspec.Struct):
    downscale: Annotated[float, Meta(ge=1, le=0xFFFF)] = 1.0


class _Info(msgspec.Struct):
    """What is read of `scene.json` besides the version; it may hold more."""

    capture: FilePath | None = None
    capture_relative: FilePath | None = None  # to the scene's folder; earlier ones lack it
    test_views: tuple[PhotoName, ...] = ()
    settings: _Settings = msgspec.field(default_factory=_Settings)
    fits: tuple[Literal["colors", "pose"], ...] = ()  # what was fitted to each photo
    world_offset: tuple[_Coordinate, _Coordinate, _Coordinate] = ORIGIN


class _Metrics(msgspec.Struct):
    train: dict[str, Any] = {}
    """Those of the scene before it was styled."""


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
    with atomic_folder(path, overwrite=overwrite, marker=SCENE) as folder:
        _write(scene, folder, Path(path))


def revise(before: Scene, after: Scene, path: Path | str) -> None:
    """Write what differs between two scenes into the folder of the first; other files stay."""
    with revise_folder(_scene_folder(path)) as folder:
        _write(after, folder, Path(path), before)


@check_arguments
def open(path: Path | str) -> Scene:
    """Read a scene.

    Raises:
        StyleSplatError: If the folder is no scene, or a file of it is missing, damaged, or made
            for other splats.
    """
    folder = _scene_folder(path)
    for _ in range(ATTEMPTS):  # again, if another process changed the folder meanwhile
        before = _state(folder)
        try:
            scene = _read(folder)
        except StyleSplatError:
            if _state(folder) == before:
                raise
        else:
            if _state(folder) == before:
                return scene
    raise StyleSplatError(
        f"Cannot read {folder}: it was changed all {ATTEMPTS} times. Try again when that is done."
    )


def content_files(folder: Path) -> Iterator[Path]:
    """The files that say what a scene is, as far as they are there.

    Figures and pictures of it are left out: `objects` and `evaluate` write them beside these.
    """
    yield from (folder / name for name in CONTENT if (folder / name).is_file())
    if (folder / LAYERS).is_dir():
        yield from sorted((folder / LAYERS).iterdir())


def _state(folder: Path) -> tuple[int, ...] | None:
    """Differs after every change of a folder: it is another folder, or has other names."""
    try:
        found = folder.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns


def _read(folder: Path) -> Scene:
    declared, info = _read_info(folder / SCENE)
    is_painted = (folder / STACK).exists()
    base = _read_gaussians(folder / (BASE if is_painted else SCENE_SPLATS), declared.world_offset)
    layers = read_layers(folder, len(base)) if is_painted else ()
    metrics = read_json(folder / METRICS, most=MAX_JSON)
    convert_checked(metrics, _Metrics, f"Cannot read {folder / METRICS}", SCENE_AGAIN)
    if (folder / VERSION_1_FILES[0]).exists():
        say(
            f"{folder} was written by an earlier StyleSplat: its paint stays, but cannot be undone "
            "or adjusted."
        )
    shown = sum(len(layer.parents) for layer in layers if layer.is_shown)
    base = _with_identities(base, folder / IDENTITY_FILE, len(base) + shown)
    scene = Scene(
        base=base,
        cameras=read_cameras(folder / CAMERAS),
        held_out=declared.test_views,
        downscale=declared.settings.downscale,
        layers=layers,
        path=folder,
        capture=find_capture(folder, declared.capture, declared.capture_relative),
        info=info,
        metrics=metrics,
    )
    if is_painted and (folder / SCENE_SPLATS).exists():
        _refuse_edited(scene, folder)
    return replace(scene, objects=_read_objects(folder, scene))


def _refuse_edited(scene: Scene, folder: Path) -> None:
    """Refuse a splats.ply that does not show the base and the layers."""
    found, composed = _read_gaussians(folder / SCENE_SPLATS, scene.world_offset), scene.splats
    rows = torch.linspace(0, len(composed) - 1, min(len(composed), COMPARED)).long()
    if len(found) != len(composed) or not all(
        torch.allclose(tensor[rows], composed.tensors()[name][rows], rtol=SAME, atol=SAME)
        for name, tensor in found.tensors().items()
    ):
        way = shell_command("import", "MOVED.ply", "--like", folder, "-o", "OTHER")
        raise StyleSplatError(
            f"{folder / SCENE_SPLATS} is not what {BASE} and the layers show: it was edited, or "
            f"belongs to another scene. Move it out of the folder, then `{way}`."
        )


def _read_gaussians(path: Path, offset: Offset) -> Splats:
    splats = read_splat_ply(path)
    if not len(splats):
        raise StyleSplatError(f"Cannot read {path}: there are no Gaussians. {SCENE_AGAIN}")
    means = splats.means.float()
    return replace(splats, means=means, shN=pad_bands(splats.shN), world_offset=offset)


def _with_identities(base: Splats, path: Path, count: int) -> Splats:
    """The base with its identities, from a file of those of `count` Gaussians."""
    if not path.exists():
        return base
    tensors = read_tensors(path, IDENTITY_TENSORS, N=count)
    ids = tuple(tensors.pop("ids").tolist())
    if not ids:
        raise StyleSplatError(f"Cannot read {path}: it knows no objects. {SCENE_AGAIN}")
    classifier = Classifier(tensors.pop("weight"), tensors.pop("bias"), ids)
    own = {name: tensor[: len(base)].clone() for name, tensor in tensors.items()}
    return replace(base, **own, classifier=classifier)


def _read_info(path: Path) -> tuple[_Info, dict[str, Any]]:
    """What scene.json declares, and the rest of its content."""
    content = read_json(path, most=MAX_JSON)
    if content.pop("version", None) not in (1, SCENE_VERSION):
        raise StyleSplatError(
            f"{path} is not of version 1 or {SCENE_VERSION}. Read it with the StyleSplat that made "
            "it, or train again."
        )
    declared = convert_checked(content, _Info, f"Cannot read {path}", SCENE_AGAIN)
    settings = content.pop("settings", {})
    settings.pop("downscale", None)
    own = ("capture", "capture_relative", "test_views", "world_offset")
    others = {key: value for key, value in content.items() if key not in own}
    return declared, others | ({"settings": settings} if settings else {})


def _read_objects(folder: Path, scene: Scene) -> dict[str, SceneObject]:
    path, what, remedy = folder / OBJECTS, f"Cannot read {folder / OBJECTS}", "Select again."
    picks = read_tensors(folder / PICKS, PICKED, N=len(scene.splats))
    records = read_json(path, most=MAX_JSON)
    records = convert_checked(records, dict[str, dict[str, Any]], what, remedy)
    records = {name: _with_lists(record) for name, record in records.items()}
    selections = convert_checked(records, dict[str, Selection], what, remedy)
    for name in selections:
        fault = name_fault(name) or (None if name in picks else f"{PICKS} lacks it")
        if fault:
            raise StyleSplatError(
                f"Cannot read {path}: no object is called {shorten(name)!r}, for {fault}. "
                "Select it again."
            )
    objects = dict[str, SceneObject]()
    for name, selection in selections.items():
        mask = picks[name][: len(scene.base)].clone()
        if not mask.any():  # earlier versions had objects of surfels alone
            mask = scene.to_base(picks[name].int()) > 0
        objects[name] = SceneObject(mask, selection)
    return objects


def object_record(found: SceneObject) -> dict[str, Any]:
    """What `objects.json` holds of an object: its selection, and the number of its Gaussians."""
    given = msgspec.structs.asdict(found.selection)
    record = {key: value for key, value in given.items() if value or key in ("ids", "threshold")}
    record |= {key: record[key][0] for key in ALONE if len(record.get(key, ())) == 1}
    return record | {"gaussians": int(found.mask.sum())}


def _with_lists(record: dict[str, Any]) -> dict[str, Any]:
    """A record whose keys of `ALONE` have lists of one, too."""
    lists = dict[str, list[Any]]()
    for key in ALONE.keys() & record.keys():
        value, kind = record[key], ALONE[key]
        several = isinstance(value, list) and all(isinstance(each, kind) for each in value)
        lists[key] = value if several else [value]
    return record | lists


def _write(scene: Scene, folder: Path, place: Path, before: Scene | None = None) -> None:
    """Write a scene, or only what differs from `before`, into a folder that will lie at `place`."""

    def differs(*names: str) -> bool:
        return before is None or any(getattr(scene, n) is not getattr(before, n) for n in names)

    if differs("splats") or not (folder / SCENE_SPLATS).exists():  # moved away as an edited one
        fault = splat_fault(scene.splats) if len(scene.splats) else "there are no Gaussians"
        if fault:
            raise StyleSplatError(f"Cannot save the scene: {fault}. Remove what is wrong.")
        write_splat_ply(scene.splats, folder / SCENE_SPLATS)
        _write_identities(scene.splats, folder / IDENTITY_FILE)
    if differs("cameras"):
        write_cameras(scene.cameras, folder / CAMERAS)
    if differs("objects", "splats"):
        for name in scene.objects:
            check_name(name)
        picks = {name: scene.to_splats(each.mask) for name, each in scene.objects.items()}
        write_tensors(picks, folder / PICKS)
        known = read_json(folder / OBJECTS, most=MAX_JSON) if before else {}
        own = (*Selection.__struct_fields__, "gaussians")
        records = {
            name: object_record(each)
            | {key: value for key, value in known.get(name, {}).items() if key not in own}
            for name, each in scene.objects.items()
        }
        write_json(records, folder / OBJECTS)
    if not scene.layers:
        (folder / BASE).unlink(missing_ok=True)
    elif differs("base") or not (before and before.layers):
        write_splat_ply(scene.base, folder / BASE)
    if differs("layers"):
        write_layers(scene.layers, folder, before.layers if before else ())
    for name in VERSION_1_FILES:
        (folder / name).unlink(missing_ok=True)
    if differs("metrics"):
        write_json(scene.metrics, folder / METRICS)
    old = (
        before is not None
        and read_json(folder / SCENE, most=MAX_JSON).get("version") != SCENE_VERSION
    )
    if old or differs("info", "capture", "held_out", "downscale", "world_offset"):
        relative = {}
        if scene.capture is not None:
            with suppress(ValueError):  # on another drive of Windows
                way = os.path.relpath(scene.capture.resolve(), place.resolve())
                relative["capture_relative"] = way
        info = {
            **scene.info,
            "version": SCENE_VERSION,
            "capture": scene.capture,
            **relative,
            "test_views": scene.held_out,
            "settings": {**scene.info.get("settings", {}), "downscale": scene.downscale},
            **({"world_offset": scene.world_offset} if scene.world_offset != ORIGIN else {}),
        }
        write_json(info, folder / SCENE)


def _write_identities(splats: Splats, path: Path) -> None:
    if splats.identities is None or splats.classifier is None:
        path.unlink(missing_ok=True)
        return
    classifier = splats.classifier
    tensors = {"weight": classifier.weight, "bias": classifier.bias}
    tensors |= {"ids": torch.tensor(classifier.ids), "identities": splats.identities}
    confidence = {} if splats.confidence is None else {"confidence": splats.confidence}
    write_tensors(tensors | confidence, path)


def _scene_folder(path: Path | str) -> Path:
    if not (Path(path) / SCENE).is_file():
        raise wrong_kind_error(Path(path), "scene")
    return Path(path)
