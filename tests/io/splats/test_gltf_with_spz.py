"""glTF whose splats are SPZ, as Cesium's tilers write it: SPZ's numbers are in the mesh's axes."""

import json
from pathlib import Path

import pytest
import torch

from scenes import NAME, Json, changed_glb, extension, glb_of, random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.rendering.reference import rotation_matrices

SPZ = "KHR_gaussian_splatting_compression_spz_2"
COUNT = 50


def with_spz(path: Path, packed: bytes, name: str = SPZ) -> Path:
    """A GLB with that and without attributes."""
    splatting = {NAME: {"extensions": {name: {"bufferView": 0}}}}
    document: Json = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "buffers": [{"byteLength": len(packed)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(packed)}],
        "meshes": [{"primitives": [{"attributes": {}, "extensions": splatting}]}],
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
    path = with_spz(tmp_path / "a.glb", packed.read_bytes(), name)
    found = read_splats(path)
    assert torch.equal(found.means, expected.means * torch.tensor([-1.0, 1.0, -1.0]))
    assert torch.equal(found.scales, expected.scales)
    assert torch.equal(found.opacities, expected.opacities)
    assert found.sh_degree == expected.sh_degree == 2
    assert torch.equal(found.shN.abs(), expected.shN.abs())
    changed_glb(path, lambda d: d.update(nodes=[{"mesh": 0, "rotation": [1, 0, 0, 0]}]))
    again = read_splats(path)  # half a turn about x is what is left
    assert torch.equal(again.means, expected.means * torch.tensor([-1.0, -1.0, 1.0]))


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("degree", [0, 3])
def test_spz_within_is_written_if_its_version_is_asked_for(
    tmp_path: Path, suffix: str, degree: int
):
    splats = random_splats(COUNT, sh_degree=degree)
    splats.shN.clamp_(-0.9, 0.9)
    path = tmp_path / f"a{suffix}"
    write_splats(splats, path, spz_version=2)
    found = read_splats(path)
    write_splats(splats, tmp_path / "a.spz", spz_version=2)
    alone = read_splats(tmp_path / "a.spz")
    assert (found.means - splats.means).abs().max() < 1e-5
    assert (found.opacities - alone.opacities).abs().max() < 1e-6
    assert (found.scales - alone.scales).abs().max() < 1e-6
    assert torch.allclose(found.sh0, alone.sh0) and found.sh_degree == degree
    assert degree == 0 or (found.shN - splats.shN).abs().max() < 0.05
    axes, others = (rotation_matrices(s.quats).double() for s in (found, splats))
    assert (axes * others).sum(dim=1).abs().min() > 0.999  # half a turn about an axis is none


def test_what_cesium_takes_from_the_json(tmp_path: Path):
    path = tmp_path / "a.gltf"
    write_splats(random_splats(COUNT, sh_degree=1), path, spz_version=2)
    document = json.loads(path.read_text())
    assert document["extensionsRequired"] == document["extensionsUsed"] == [NAME, SPZ]
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["extensions"][NAME]["extensions"] == {SPZ: {"bufferView": 0}}
    bands = {f"{NAME}:SH_DEGREE_1_COEF_{n}" for n in range(3)}
    assert set(primitive["attributes"]) == {"POSITION", "COLOR_0", *bands} | {
        f"{NAME}:{each}" for each in ("ROTATION", "SCALE")
    }
    accessors = document["accessors"]
    assert all(each["count"] == COUNT and "bufferView" not in each for each in accessors)
    color = accessors[primitive["attributes"]["COLOR_0"]]
    assert color["componentType"] == 5121 and color["type"] == "VEC4" and color["normalized"]
    assert len(document["nodes"][0]["matrix"]) == 16
    for version in (3, 4):
        with pytest.raises(StyleSplatError, match=f"SPZ of version 2, not {version}"):
            write_splats(random_splats(COUNT), path, spz_version=version)


REFUSED = {
    "no view of SPZ: number 3 of 1": lambda d: packing(d).update(bufferView=3),
    r"a\.glb as splats: ": lambda d: d["bufferViews"][0].update(byteLength=100),
}


def packing(document: Json) -> Json:
    return extension(document)["extensions"][SPZ]


@pytest.mark.parametrize("expected", [*REFUSED])
def test_what_does_not_fit_is_told_in_one_line(tmp_path: Path, packed: Path, expected: str):
    path = with_spz(tmp_path / "a.glb", packed.read_bytes())
    changed_glb(path, REFUSED[expected])
    with pytest.raises(StyleSplatError, match=expected) as caught:
        read_splats(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
