import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load, save

from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import Scene, Unsplit, read_scene, update_scene, write_scene
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Classifier, Splats

COUNT = 6


def random(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(sum(shape)))


def plain_scene(dtype: torch.dtype = torch.float32) -> Scene:
    splats = Splats(
        means=random(COUNT, 3),
        quats=random(COUNT, 4),
        scales=random(COUNT, 3),
        opacities=random(COUNT),
        sh0=random(COUNT, 1, 3),
        shN=random(COUNT, 15, 3),
    )
    cameras = Cameras(
        viewmats=random(2, 4, 4).to(dtype) / 3,
        Ks=random(2, 3, 3).to(dtype) / 3,
        sizes=torch.tensor([[640, 480], [500, 400]]),
        names=("a.jpg", "sub/b.png"),
    )
    return Scene(splats, cameras)


def full_scene() -> Scene:
    scene = plain_scene()
    classifier = Classifier(random(3, 16), random(3), ids=(0, 7, 70000))
    return replace(
        scene,
        splats=replace(
            scene.splats,
            identities=random(COUNT, 16),
            classifier=classifier,
            confidence=random(COUNT).sigmoid(),
        ),
        picks={"fox": torch.arange(COUNT) % 2 == 0, "a name": torch.zeros(COUNT, dtype=torch.bool)},
        objects={"fox": {"ids": [7], "count": 3}, "a name": {"count": 0}},
        info={"capture": "garden", "test": ["a.jpg"], "settings": {"steps": 500}},
        metrics={"psnr": 30.5},
        base_colors={"sh0": random(COUNT, 1, 3), "shN": random(COUNT, 15, 3)},
        recipe={"seed": 0},
    )


def assert_same(found: Scene, scene: Scene) -> None:
    assert found.splats.tensors().keys() == scene.splats.tensors().keys()
    pairs = [(found.splats.tensors()[k], t) for k, t in scene.splats.tensors().items()]
    a, b = found.splats.classifier, scene.splats.classifier
    assert (a is None) == (b is None)
    if a and b:
        assert a.ids == b.ids
        pairs += [(a.weight, b.weight), (a.bias, b.bias)]
    assert found.cameras.names == scene.cameras.names
    for name in ("viewmats", "Ks", "sizes"):
        pairs.append((getattr(found.cameras, name), getattr(scene.cameras, name)))
    for name in ("picks", "base_colors"):
        tensors, others = getattr(found, name) or {}, getattr(scene, name) or {}
        assert tensors.keys() == others.keys()
        pairs += [(tensors[key], others[key]) for key in tensors]
    for name in ("objects", "info", "metrics", "recipe"):
        assert getattr(found, name) == getattr(scene, name)
    assert all(a.dtype == b.dtype and torch.equal(a, b) for a, b in pairs)


@pytest.mark.parametrize("make", [plain_scene, full_scene])
def test_round_trip(tmp_path: Path, make: Callable[[], Scene]):
    scene = make()
    write_scene(scene, tmp_path / "scene")
    assert_same(read_scene(tmp_path / "scene"), scene)


def test_what_undoes_a_split_comes_back(tmp_path: Path):
    shape = Unsplit(4, torch.tensor([0, 3]), random(2, 3), random(2))
    write_scene(replace(full_scene(), unsplit=shape), tmp_path / "scene")
    found = read_scene(tmp_path / "scene").unsplit
    assert found is not None and found.count == 4
    for name in ("rows", "scales", "opacities"):
        assert torch.equal(getattr(found, name), getattr(shape, name))
    write_scene(full_scene(), tmp_path / "scene", overwrite=True)
    assert read_scene(tmp_path / "scene").unsplit is None


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_cameras_are_exact(tmp_path: Path, dtype: torch.dtype):
    scene = plain_scene(dtype)
    write_scene(scene, tmp_path / "scene")
    assert_same(read_scene(tmp_path / "scene"), scene)


def test_the_files_of_a_scene(tmp_path: Path):
    write_scene(plain_scene(), tmp_path / "plain")
    write_scene(full_scene(), tmp_path / "full")
    plain = {"scene.json", "splats.ply", "cameras.json", "objects.json", "picks.safetensors"}
    plain.add("metrics.json")
    assert {p.name for p in (tmp_path / "plain").iterdir()} == plain
    assert {p.name for p in (tmp_path / "full").iterdir()} == plain | {
        *("identities.safetensors", "base_colors.safetensors", "recipe.json")
    }


def test_base_colors_have_the_bands_that_the_splats_get(tmp_path: Path):
    scene = full_scene()
    assert scene.base_colors is not None
    base_colors = {**scene.base_colors, "shN": scene.base_colors["shN"][:, :3]}
    write_scene(replace(scene, base_colors=base_colors), tmp_path / "scene")
    found = read_scene(tmp_path / "scene")
    assert found.base_colors is not None
    assert found.base_colors["shN"].shape == found.splats.shN.shape
    assert torch.equal(found.base_colors["shN"][:, :3], base_colors["shN"])


def test_an_update_changes_nothing_else(tmp_path: Path):
    scene = full_scene()
    write_scene(scene, tmp_path / "scene")
    before = {p.name: p.read_bytes() for p in (tmp_path / "scene").iterdir()}
    picks = {"table": torch.ones(COUNT, dtype=torch.bool)}
    update_scene(tmp_path / "scene", picks=picks, objects={"table": {"count": COUNT}})
    after = {p.name: p.read_bytes() for p in (tmp_path / "scene").iterdir()}
    changed = {name for name in before | after if before.get(name) != after.get(name)}
    assert changed == {"picks.safetensors", "objects.json"}
    update_scene(tmp_path / "scene", metrics={"psnr": 1.0})
    expected = replace(
        scene, picks=picks, objects={"table": {"count": COUNT}}, metrics={"psnr": 1.0}
    )
    assert_same(read_scene(tmp_path / "scene"), expected)


def test_a_scene_is_not_overwritten_by_accident(tmp_path: Path):
    write_scene(full_scene(), tmp_path / "scene")
    with pytest.raises(StyleSplatError, match=r"holds an earlier result.*`--overwrite`"):
        write_scene(plain_scene(), tmp_path / "scene")
    assert_same(read_scene(tmp_path / "scene"), full_scene())
    write_scene(plain_scene(), tmp_path / "scene", overwrite=True)
    assert_same(read_scene(tmp_path / "scene"), plain_scene())


def test_no_scene(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"is not a scene.*`stylesplat train CAPTURE -o"):
        read_scene(tmp_path)
    with pytest.raises(StyleSplatError, match="is not a scene"):
        update_scene(tmp_path, metrics={})


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("scene.json", b"{", "not valid JSON"),
        ("scene.json", b"{}", "not of version 1"),
        ("scene.json", b'{"version": 2}', "not of version 1"),
        ("splats.ply", b"", "not a PLY file"),
        ("splats.ply", None, "No such file"),
        ("cameras.json", None, "No such file"),
        ("cameras.json", b"{}", "no 'dtype'"),
        ("cameras.json", b'{"dtype": "float32", "cameras": [{"name": "a"}]}', "no 'viewmat'"),
        ("cameras.json", b'{"dtype": "float32", "cameras": 1}', "not iterable"),
        ("objects.json", b"[]", "expected a JSON object"),
        ("picks.safetensors", b"1234", "Make the scene again"),
        ("picks.safetensors", None, "No such file"),
        ("identities.safetensors", b"1234", "Make the scene again"),
        ("base_colors.safetensors", b"1234", "Make the scene again"),
        ("metrics.json", b"", "not valid JSON"),
        ("recipe.json", b"", "not valid JSON"),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, content: bytes | None, match: str):
    write_scene(full_scene(), tmp_path / "scene")
    path = tmp_path / "scene" / name
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(StyleSplatError, match=match) as caught:
        read_scene(tmp_path / "scene")
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_files_of_different_scenes(tmp_path: Path):
    scene = full_scene()
    write_scene(scene, tmp_path / "scene")
    update_scene(tmp_path / "scene", picks={"fox": torch.ones(COUNT + 1, dtype=torch.bool)})
    with pytest.raises(StyleSplatError, match=r"fox has the shape \[7\], .* 6 Gaussians"):
        read_scene(tmp_path / "scene")


def test_identities_that_were_not_lifted_have_no_confidence(tmp_path: Path):
    scene = full_scene()
    scene = replace(scene, splats=replace(scene.splats, confidence=None))
    write_scene(scene, tmp_path / "scene")
    assert_same(read_scene(tmp_path / "scene"), scene)


def test_confidence_of_another_scene(tmp_path: Path):
    scene = full_scene()
    splats = replace(scene.splats, confidence=None)
    write_scene(replace(scene, splats=splats), tmp_path / "scene")
    path = tmp_path / "scene/identities.safetensors"
    path.write_bytes(save({**load(path.read_bytes()), "confidence": torch.ones(COUNT - 1)}))
    with pytest.raises(StyleSplatError, match=r"confidence has the shape \[5\]"):
        read_scene(tmp_path / "scene")


def test_identities_without_a_classifier(tmp_path: Path):
    write_scene(full_scene(), tmp_path / "scene")
    picks = tmp_path / "scene/picks.safetensors"
    (tmp_path / "scene/identities.safetensors").write_bytes(picks.read_bytes())
    with pytest.raises(StyleSplatError, match="it has no bias"):
        read_scene(tmp_path / "scene")


def test_the_camera_file_is_plain_json(tmp_path: Path):
    write_scene(plain_scene(), tmp_path / "scene")
    content = json.loads((tmp_path / "scene/cameras.json").read_text())
    assert content["cameras"][1]["name"] == "sub/b.png"
    assert content["cameras"][1]["size"] == [500, 400]
