"""glTF whose splats are SPZ, as Cesium's tilers write it: SPZ's numbers are in the mesh's axes."""

from pathlib import Path

import pytest
import torch

from scenes import NAME, Json, changed_glb, extension, glb_of, random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats

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


REFUSED = {
    "no view of SPZ: number 3 of 1": lambda d: packing(d).update(bufferView=3),
    "as SPZ: ": lambda d: d["bufferViews"][0].update(byteLength=100),
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
