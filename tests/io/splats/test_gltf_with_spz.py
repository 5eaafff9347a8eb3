"""glTF whose splats are SPZ, as Cesium's tilers write it: SPZ's numbers are in the mesh's axes."""

import json
from pathlib import Path

import pytest
import torch

from scenes import NAME, Json, changed_glb, extension, glb_of, random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats

SPZ = "KHR_gaussian_splatting_compression_spz_2"
COUNT = 50


def with_spz(path: Path, packed: bytes, count: int, name: str = SPZ) -> Path:
    """A GLB with that, its attributes without numbers, as the extension's draft has them."""
    kinds = {"POSITION": "VEC3", f"{NAME}:ROTATION": "VEC4", f"{NAME}:SCALE": "VEC3"}
    document: Json = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [NAME, name],
        "extensionsRequired": [NAME, name],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "buffers": [{"byteLength": len(packed)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(packed)}],
        "accessors": [
            {"componentType": 5126, "count": count, "type": kind} for kind in kinds.values()
        ],
        "meshes": [
            {
                "primitives": [
                    {
                        "mode": 0,
                        "attributes": {each: index for index, each in enumerate(kinds)},
                        "extensions": {NAME: {"extensions": {name: {"bufferView": 0}}}},
                    }
                ]
            }
        ],
    }
    path.write_bytes(glb_of(document, packed + bytes(-len(packed) % 4)))
    return path


@pytest.fixture
def packed(tmp_path: Path) -> Path:
    """The same splats as `.spz`."""
    write_splats(random_splats(COUNT, sh_degree=2), tmp_path / "a.spz")
    return tmp_path / "a.spz"


@pytest.mark.parametrize("name", [SPZ, SPZ.removesuffix("_2")])
def test_spz_within_is_read_and_placed_as_any_splats(tmp_path: Path, packed: Path, name: str):
    """A `.spz` has y up, and x right where glTF's is left: half a turn about y is in between."""
    expected = read_splats(packed)
    path = with_spz(tmp_path / "a.glb", packed.read_bytes(), COUNT, name)
    found = read_splats(path)
    assert torch.equal(found.means, expected.means * torch.tensor([-1.0, 1.0, -1.0]))
    assert torch.equal(found.scales, expected.scales)
    assert torch.equal(found.opacities, expected.opacities)
    assert found.sh_degree == expected.sh_degree == 2
    assert torch.equal(found.shN.abs(), expected.shN.abs())
    changed_glb(path, lambda d: d.update(nodes=[{"mesh": 0, "rotation": [1, 0, 0, 0]}]))
    again = read_splats(path)  # half a turn about x is what is left
    assert torch.equal(again.means, expected.means * torch.tensor([-1.0, -1.0, 1.0]))


REFUSED = {
    "no view of SPZ: number 3 of 1": lambda d: packing(d).update(bufferView=3),
    "as SPZ: ": lambda d: d["bufferViews"][0].update(byteLength=100),
}


def packing(document: Json) -> Json:
    return extension(document)["extensions"][SPZ]


@pytest.mark.parametrize("expected", [*REFUSED])
def test_what_does_not_fit_is_told_in_one_line(tmp_path: Path, packed: Path, expected: str):
    path = with_spz(tmp_path / "a.glb", packed.read_bytes(), COUNT)
    changed_glb(path, REFUSED[expected])
    with pytest.raises(StyleSplatError, match=expected) as caught:
        read_splats(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_a_gltf_that_is_all_text(tmp_path: Path):
    """Its JSON is the GLB's, but for where the bytes are."""
    for count in (3, 4, 5):  # base64 takes bytes by threes
        splats = random_splats(count, sh_degree=1)
        write_splats(splats, tmp_path / "a.gltf")
        write_splats(splats, tmp_path / "a.glb")
        one, other = read_splats(tmp_path / "a.gltf"), read_splats(tmp_path / "a.glb")
        for name, values in one.tensors().items():
            assert torch.equal(values, getattr(other, name)), name
    document = json.loads((tmp_path / "a.gltf").read_text())
    assert document["buffers"][0]["uri"].startswith("data:application/octet-stream;base64,")
    assert [path.name for path in tmp_path.iterdir() if ".bin" in path.name] == []
