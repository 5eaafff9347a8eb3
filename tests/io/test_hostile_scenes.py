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

from processes import needs_pipes
from scenes import COUNT, full_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.scene.objects import SceneObject

BAD_NAMES = ["__metadata__", "../a", "a\nb", "x" * 101, "42", "a=b"]
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


VALUES: dict[tuple[Any, ...], tuple[object, ...]] = {  # wrong ones, by the place in a file
    ("scene.json", "capture"): (3, "a\0b"),
    ("scene.json", "test_views"): ([3], ["a\nb"]),
    ("scene.json", "settings"): ({"downscale": 0}, {"downscale": 10**400}),
    ("cameras.json", "cameras"): ([], [None]),
    ("cameras.json", "cameras", 0, "size"): ([60_000, 60_000],),
    ("cameras.json", "cameras", 0, "name"): ("a\nb", "sub/b.png"),
    ("cameras.json", "cameras", 0, "viewmat"): ([[0.0] * 4] * 4, [[1e300] * 4] * 4),
    ("cameras.json", "cameras", 0, "K"): ([[0.0] * 3] * 3,),
    ("layers.json", "layers"): ([], [3], [{}]),
    ("layers.json", "layers", 0, "object"): ("../a", "7"),
    ("layers.json", "layers", 0, "file"): ("../picks.safetensors", "01-a/b.safetensors", 3),
    ("layers.json", "layers", 0, "styles"): ([{"path": "a\0"}],),
    ("layers.json", "layers", 0, "settings"): (None, {"form": 9}),
    ("layers.json", "layers", 0, "strength"): (9, float("nan")),
    ("objects.json", "fox"): (
        *(3, {"ids": 3}, {"ids": [-1]}, {"points": 3}, {"points": [["a.jpg", 3]]}, {"text": 3}),
        *({"box3d": [1, 2]}, {"sphere": ["", [1]]}, {"size": "large"}, {"scores": {"fox": 1}}),
    ),
    ("metrics.json", "train"): (3,),
}
JSON_MUTANTS: list[tuple[str, Change]] = [
    *((path[0], put(*path[1:], value=v)) for path, values in VALUES.items() for v in values),
    *(("objects.json", put(name, value={})) for name in BAD_NAMES),
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
    ("picks", without("fox")),
    (FOX, with_tensor("extra", ONES(COUNT))),
    (FOX, with_tensor("shN", ONES(2, 7, 3))),
    *((FOX, with_tensor("rows", torch.tensor(rows))) for rows in ([0, 6], [0, -1], [0, 0], [0])),
    (FOX, with_tensor("parents", torch.tensor([0, 1, 6]))),
    *(("identities", with_tensor("ids", torch.tensor(ids))) for ids in ([0, 0, 7], [0, 7, 2**24])),
    ("identities", lambda t: {**t, "ids": t["ids"][:0], "weight": ONES(0, 16), "bias": ONES(0)}),
    ("picks", lambda t: dict.fromkeys(t, ONES(COUNT))),
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
        stored("F4", [2], b"\0"),
        stored("BOOL", [COUNT], b"\0\1\2\3\4\5"),
        stored("BOOL", [2**62, 4], b""),
    ],
    ids=range(4),
)
def test_headers_that_lie(folder: Path, content: bytes):
    (folder / "picks.safetensors").write_bytes(content)
    refused(folder, "picks.safetensors")


@needs_pipes
@pytest.mark.parametrize(
    "name", ["cameras.json", "splats.ply", "picks.safetensors", "identities.safetensors"]
)
def test_pipes_devices_and_folders_are_no_files(folder: Path, name: str):
    path = folder / name
    path.rename(folder / "elsewhere")
    if name not in ("identities.safetensors", "splats.ply"):  # a painted scene needs neither
        refused(folder, name)
    path.touch()
    for make in (os.mkfifo, Path.mkdir, lambda path: path.symlink_to("/dev/zero")):
        path.rmdir() if path.is_dir() else path.unlink()
        make(path)
        refused(folder, name)


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
