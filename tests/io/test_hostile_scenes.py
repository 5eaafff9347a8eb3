"""A scene whose files hold anything but what they declare is refused, in one line."""

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load, save

from scenes import COUNT, full_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.scene.scene import SceneObject

BAD_NAMES = ["__metadata__", "a/b", "../a", "a\nb", "a\x00b", "x" * 101, " ", "42", "a=b"]
ONES = torch.ones
FOX = "layers/01-fox"
Change = Callable[[Any], Any]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    scene_folder.save(full_scene(), tmp_path / "scene")
    return tmp_path / "scene"


def refused(folder: Path, name: str) -> None:
    """Opening it is, in one line that names the file."""
    with pytest.raises(StyleSplatError) as caught:
        scene_folder.open(folder)
    assert name in str(caught.value) and str(caught.value).isprintable()


def put(*keys: str | int, value: object) -> Change:
    """Change one thing deep in plain values."""

    def change(content: Any) -> Any:
        inside = content
        for key in keys[:-1]:
            inside = inside[key]
        inside[keys[-1]] = value
        return content

    return change


def camera(*keys: str | int, value: object) -> Change:
    return put("cameras", 0, *keys, value=value)


def layer(key: str, value: object) -> Change:
    return put("layers", 0, key, value=value)


SCENE: dict[str, tuple[object, ...]] = {
    "capture": (3, "a\0b", "\ud800"),
    "test_views": (3, [3], ["a\nb"]),
    "settings": (3, {"downscale": 0}, {"downscale": 10**400}, {"downscale": float("nan")}),
}
CAMERA: dict[str, tuple[object, ...]] = {
    "size": ([-4, 3], [0, 3], [60_000, 60_000], [1.5, 3], [3]),
    "name": ("", 3, "a\nb", "sub/b.png"),
    "viewmat": ([[0.0] * 4] * 4, [[1.0] * 4] * 3, [[float("nan")] * 4] * 4, [[1e300] * 4] * 4),
    "K": ([[0.0] * 3] * 3, [[float("nan")] * 3] * 3),
}
LAYER: dict[str, tuple[object, ...]] = {
    "object": (*BAD_NAMES[:-3], 3, "7"),
    "file": ("../picks.safetensors", "01-a/b.safetensors", "..", "01-fox.safetensors\n", 3),
    "kind": ("photo", 3),
    "styles": (3, [3], [{"path": "a\0"}], [{"sha256": "x" * 200}]),
    "settings": (None, {"form": "x"}, {"form": 9}),
    "strength": ("x", -1, 9, float("nan")),
    "form": ("x", -1, 9),
    "visible": ("x", 1),
    "features": (3, "a\nb"),
    "weights": (3, "a"),
}
JSON_MUTANTS: list[tuple[str, Change]] = [
    *(("scene.json", put(key, value=v)) for key, values in SCENE.items() for v in values),
    *(("cameras.json", camera(key, value=v)) for key, values in CAMERA.items() for v in values),
    *(("layers.json", layer(key, v)) for key, values in LAYER.items() for v in values),
    ("cameras.json", put("dtype", value="float16")),
    *(("cameras.json", put("cameras", value=value)) for value in ([], {}, [None])),
    *(("objects.json", put(name, value={})) for name in BAD_NAMES),
    *(("objects.json", put("fox", value=v)) for v in (3, {"ids": 3}, {"ids": [-1]})),
    ("metrics.json", put("train", value=3)),
    *(("layers.json", put("layers", value=value)) for value in ([], {}, [3], [{}])),
]


@pytest.mark.parametrize(("name", "change"), JSON_MUTANTS, ids=lambda each: str(each)[:12])
def test_json_that_does_not_fit(folder: Path, name: str, change: Change):
    path = folder / name
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    refused(folder, name)


def with_tensor(name: str, value: torch.Tensor) -> Change:
    return lambda tensors: {**tensors, name: value}


def without(name: str) -> Change:
    return lambda tensors: {key: value for key, value in tensors.items() if key != name}


def changed(name: str, change: Change) -> Change:
    return lambda tensors: {**tensors, name: change(tensors[name])}


def filled(value: float) -> Change:
    return lambda tensor: torch.full_like(tensor, value)


TENSOR_MUTANTS: list[tuple[str, Change]] = [
    *(
        (file, changed(name, change))
        for file, name in (
            ("identities", "identities"),
            ("identities", "confidence"),
            *((FOX, name) for name in ("shares", "shN", "relief", "canvas_means")),
        )
        for change in (torch.Tensor.half, filled(torch.nan), filled(1e30), lambda t: t[:1].clone())
    ),
    *(("identities", without(name)) for name in ("identities", "weight", "ids")),
    *((FOX, without(name)) for name in ("rows", "shN", "canvas_quats")),
    ("picks", without("fox")),
    (FOX, with_tensor("extra", ONES(COUNT))),
    *((FOX, with_tensor("shN", ONES(2, bands, 3))) for bands in (7, 8)),
    *((FOX, with_tensor("rows", torch.tensor(rows))) for rows in ([0, 6], [0, -1], [0, 0], [0])),
    (FOX, with_tensor("parents", torch.tensor([0, 1, 6]))),
    (FOX, with_tensor("shares", torch.tensor([0, 1.1]))),
    *(("identities", with_tensor("ids", torch.tensor(ids))) for ids in ([0, 0, 7], [0, 7, 2**24])),
    ("identities", with_tensor("ids", torch.tensor([0.0, 7.0, 9.0]))),
    ("identities", lambda t: {**t, "ids": t["ids"][:0], "weight": ONES(0, 16), "bias": ONES(0)}),
    ("picks", lambda t: dict.fromkeys(t, ONES(COUNT))),
    ("picks", lambda t: dict.fromkeys(t, ONES(3, 2) > 0)),
]


@pytest.mark.parametrize(("name", "change"), TENSOR_MUTANTS, ids=lambda each: str(each)[:12])
def test_tensors_that_do_not_fit(folder: Path, name: str, change: Change):
    path = folder / f"{name}.safetensors"
    tensors = change(load(path.read_bytes()))
    path.write_bytes(save({key: value.clone() for key, value in tensors.items()}))
    refused(folder, f"{name}.safetensors")


def stored(dtype: str, shape: list[int], data: bytes, name: str = "fox") -> bytes:
    header = json.dumps({name: {"dtype": dtype, "shape": shape, "data_offsets": [0, len(data)]}})
    return len(header).to_bytes(8, "little") + header.encode() + data


@pytest.mark.parametrize(
    "content",
    [
        (2**63).to_bytes(8, "little") + b"{}",
        (10**8).to_bytes(8, "little") + b"{}",
        stored("F4", [2], b"\0"),
        stored("F8_E8M0", [2], b"\0\0"),
        stored("C64", [1], b"\0" * 8),
        stored("BOOL", [COUNT], b"\0\1\2\3\4\5"),
        stored("BOOL", [2**62, 4], b""),
        stored("BOOL", [0, 2**62], b""),
        stored("BOOL", [], b"\0"),
    ],
    ids=range(9),
)
def test_headers_that_lie(folder: Path, content: bytes):
    (folder / "picks.safetensors").write_bytes(content)
    refused(folder, "picks.safetensors")


@pytest.mark.parametrize(
    "name", ["cameras.json", "splats.ply", "picks.safetensors", "identities.safetensors"]
)
def test_pipes_devices_and_folders_are_no_files(folder: Path, name: str):
    path = folder / name
    for make in (os.mkfifo, Path.mkdir, lambda path: path.symlink_to("/dev/zero")):
        path.rmdir() if path.is_dir() else path.unlink()
        make(path)
        refused(folder, name)


def test_a_scene_without_gaussians_is_refused(folder: Path):
    path = folder / "splats.ply"
    head, _, _ = path.read_bytes().partition(b"end_header\n")
    path.write_bytes(head.replace(b"vertex 9", b"vertex 0") + b"end_header\n")
    refused(folder, "splats.ply")


@pytest.mark.parametrize("name", BAD_NAMES)
def test_names_that_files_cannot_have_are_not_written(name: str, tmp_path: Path):
    scene = full_scene()
    nothing = SceneObject(torch.zeros(len(scene.splats), dtype=torch.bool))
    named = replace(scene, objects={name: nothing})
    with pytest.raises(StyleSplatError, match="Cannot call an object"):
        scene_folder.save(named, tmp_path / "scene")
    first, *others = scene.layers
    drawn = (replace(first, object=name), *others)
    if name != "42":  # the id of a label
        with pytest.raises(StyleSplatError, match="Cannot call an object"):
            scene_folder.save(replace(scene, layers=drawn), tmp_path / "scene")
    assert not (tmp_path / "scene").exists()
