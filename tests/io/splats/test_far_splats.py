"""Splats at coordinates that are too large for float32, in every format that can hold them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from balls import CAMERAS, PLAIN
from ksplat_files import write_ksplat
from scenes import changed_glb, glb_parts
from stylesplat.io.ply import parse_header, read_ply_table, write_ply_rows
from stylesplat.io.splats.compressed_ply import write_compressed_ply
from stylesplat.io.splats.sog import write_sog
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.scene.world_offset import Offset, to_world

WORLD = (4e6, -3e6, 5e6)
NEAR = replace(PLAIN, shN=PLAIN.shN[:, :0])
FAR = replace(NEAR, world_offset=WORLD)


def image(splats: Splats) -> torch.Tensor:
    """As the cameras see it that stand around the place `WORLD`."""
    return rasterize(splats.relative_to(WORLD), CAMERAS[0])[0]


def assert_at_world(splats: Splats, tolerance: float = 1e-6) -> None:
    """In float32 around an offset, which are the same places and the same picture."""
    assert splats.means.dtype == torch.float32
    assert splats.world_offset == pytest.approx(WORLD, abs=1)
    places = to_world(splats.means, splats.world_offset)
    torch.testing.assert_close(places, to_world(NEAR.means, WORLD), atol=tolerance, rtol=0)
    assert (image(splats) - image(FAR)).abs().max() < max(1e-3, 100 * tolerance)


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".gltf"])
def test_formats_with_64_bits_give_the_world_back(suffix: str, tmp_path: Path, said: list[str]):
    path = tmp_path / f"a{suffix}"
    write_splats(FAR, path)
    assert not said
    assert_at_world(read_splats(path))
    (line,) = said
    assert str(path) in line and "4000000 -3000000 5000000" in line and "rounded" not in line


def test_a_ply_has_the_worlds_coordinates_as_doubles(tmp_path: Path):
    write_splats(FAR, tmp_path / "a.ply")
    table = read_ply_table(tmp_path / "a.ply")
    assert [table.dtype[name].str for name in ("x", "y", "z", "nx")] == ["<f8"] * 3 + ["<f4"]
    np.testing.assert_allclose(table["y"], NEAR.means[:, 1].double() - 3e6, atol=1e-9)
    write_splats(NEAR, tmp_path / "b.ply")
    assert not any(kind == "f8" for kind in read_ply_table(tmp_path / "b.ply").dtype.fields or ())


def test_text_has_more_digits_than_its_header_says(tmp_path: Path):
    write_splats(FAR, tmp_path / "a.ply")
    table = read_ply_table(tmp_path / "a.ply")
    lines = ["ply", "format ascii 1.0", f"element vertex {len(table)}"]
    lines += [f"property float {name}" for name in table.dtype.names or ()]
    lines += ["end_header", *(" ".join(map(repr, row)) for row in table.tolist())]
    (tmp_path / "text.ply").write_text("\n".join(lines))
    assert_at_world(read_splats(tmp_path / "text.ply"))


def test_coordinates_that_a_file_has_rounded_stay_as_they_are(tmp_path: Path, said: list[str]):
    write_splats(FAR, tmp_path / "a.ply")
    table = read_ply_table(tmp_path / "a.ply")
    kinds = [(name, "<f4") for name in table.dtype.names or ()]
    write_ply_rows(tmp_path / "b.ply", len(table), np.dtype(kinds), [table.astype(kinds)])
    splats = read_splats(tmp_path / "b.ply")
    rounded = to_world(NEAR.means, WORLD).float().double()
    assert torch.equal(to_world(splats.means, splats.world_offset), rounded)
    assert "rounded its coordinates to 0.5" in said[0]


def test_a_tree_of_gltf_nodes_adds_up_in_64_bits(tmp_path: Path):
    write_splats(NEAR, tmp_path / "a.glb")
    turn = glb_parts(tmp_path / "a.glb")[0]["nodes"][0]["rotation"]
    matrix = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -4e6, 3e6 + 0.25, 5e6, 1]
    nodes = [
        {"matrix": matrix, "children": [1]},
        {"translation": [0.0, -0.25, 0.0], "children": [2]},
        {"rotation": turn, "mesh": 0},
    ]
    changed_glb(tmp_path / "a.glb", lambda document: document.update(nodes=nodes))
    assert_at_world(read_splats(tmp_path / "a.glb"))


def test_spz_within_gltf(tmp_path: Path):
    write_splats(NEAR, tmp_path / "near.glb", spz_version=2)
    write_splats(FAR, tmp_path / "far.glb", spz_version=2)
    near, far = (read_splats(tmp_path / f"{name}.glb") for name in ("near", "far"))
    assert torch.equal(far.relative_to(WORLD).means, near.means)


def test_sog_and_ksplat(tmp_path: Path):
    there = replace(NEAR, means=to_world(NEAR.means, WORLD))
    write_sog(there, tmp_path / "a.sog")
    write_sog(NEAR, tmp_path / "near.sog")
    found, near = (read_splats(tmp_path / f"{name}.sog") for name in ("a", "near"))
    # Both are in Morton order, with 16 bits of the extent
    torch.testing.assert_close(found.relative_to(WORLD).means, near.means, atol=1e-3, rtol=0)
    some = slice(437)  # with two buckets that are not full
    write_ksplat(tmp_path / "a.ksplat", [there[some]], 1, 0)
    found = read_splats(tmp_path / "a.ksplat").relative_to(WORLD)
    # Centres of buckets are rounded to a half in the file, but what lies in one stays apart
    assert (found.means - NEAR.means[some]).abs().max() < 0.3
    assert (found.means.unique(dim=0)).shape == NEAR.means[some].unique(dim=0).shape


def moved_chunks(content: bytes, offset: Offset) -> bytes:
    """A compressed PLY whose chunks lie elsewhere; its bounds get rounded to float32."""
    _, (chunk, *_), _, start = parse_header(content)
    chunks = np.frombuffer(content, np.dtype(chunk.columns), chunk.rows, start).copy()
    for axis, shift in zip("xyz", offset, strict=True):
        for end in ("min", "max"):
            chunks[f"{end}_{axis}"] += np.float32(shift)
    return content[:start] + chunks.tobytes() + content[start + chunks.nbytes :]


def test_compressed_ply(tmp_path: Path):
    wide = replace(NEAR, means=1024 * NEAR.means)
    write_compressed_ply(wide, tmp_path / "near.ply")
    content = (tmp_path / "near.ply").read_bytes()
    (tmp_path / "far.ply").write_bytes(moved_chunks(content, WORLD))
    near, far = (read_splats(tmp_path / f"{name}.ply") for name in ("near", "far"))
    assert far.world_offset != (0, 0, 0)
    # The bounds of chunks are rounded to a half; between them there are 1024 steps of about one
    difference = far.relative_to(WORLD).means - near.means
    assert difference.abs().max() < 0.3
    steps = far.relative_to(WORLD).means[:, 0].sort().values.diff()
    assert (steps > 0).sum() > 0.8 * len(steps), "places do not fall together"


@pytest.mark.parametrize("suffix", [".spz", ".splat", ".sog", ".compressed.ply"])
def test_formats_without_it_say_what_is_missing(suffix: str, tmp_path: Path, said: list[str]):
    write_splats(FAR, tmp_path / f"far{suffix}")
    (line,) = said
    assert f"far{suffix}" in line and "4000000 -3000000 5000000" in line
    write_splats(NEAR, tmp_path / f"near{suffix}")
    assert len(said) == 1
    assert (tmp_path / f"far{suffix}").read_bytes() == (tmp_path / f"near{suffix}").read_bytes()
