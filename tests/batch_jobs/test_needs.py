"""How many Gaussians jobs are reckoned to work on."""

from pathlib import Path

import pytest

from glb_files import as_gltf, attributes, changed_glb, glb_parts
from scenes import random_splats
from stylesplat.batch_jobs.job_needs import gaussians_at
from stylesplat.io.splats.splat_files import write_splats

COUNT = 50


@pytest.fixture
def glb(tmp_path: Path) -> Path:
    """Splats as glTF."""
    write_splats(random_splats(COUNT, sh_degree=2), tmp_path / "a.glb")
    return tmp_path / "a.glb"


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".compressed.ply", ".spz", ".sog"])
def test_splats_are_no_more_than_is_reckoned(suffix: str, tmp_path: Path):
    path = tmp_path / f"a{suffix}"
    write_splats(random_splats(COUNT, sh_degree=0), path)
    assert gaussians_at(path) >= COUNT


def test_gltf_says_how_many_it_has(glb: Path, tmp_path: Path):
    assert gaussians_at(glb) == COUNT
    embedded = tmp_path / "embedded.gltf"
    write_splats(random_splats(COUNT), embedded)
    assert gaussians_at(embedded) == COUNT
    (tmp_path / "a.bin").write_bytes(glb_parts(glb)[1])
    assert gaussians_at(as_gltf(glb, "a.bin")) == COUNT, "its numbers lie beside it"


def test_a_gltf_shown_twice_counts_twice(glb: Path):
    changed_glb(glb, lambda d: d.update(nodes=[{"mesh": 0}] * 2, scenes=[{"nodes": [0, 1]}]))
    assert gaussians_at(glb) == 2 * COUNT


@pytest.mark.parametrize("fault", ["places", "json", "cut"])
def test_a_gltf_that_does_not_say_it_is_reckoned_by_its_size(fault: str, glb: Path):
    if fault == "places":
        changed_glb(glb, lambda document: attributes(document).pop("POSITION"))
    else:
        content = glb.read_bytes()
        glb.write_bytes(content.replace(b"meshes", b"me\0hes") if fault == "json" else content[:19])
    assert gaussians_at(glb) == glb.stat().st_size // 16


def test_only_the_json_of_a_glb_is_read(glb: Path):
    content = glb.read_bytes()
    glb.write_bytes(content[: len(content) - len(glb_parts(glb)[1])])
    assert gaussians_at(glb) == COUNT
