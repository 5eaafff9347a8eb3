"""SPZ by hand: all versions and degrees, axes that a record declares, the anti-aliasing mark."""

import gzip
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import zstandard

from scenes import randn, random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import open as open_scene
from stylesplat.io.scene_folder import save
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.scene.splats import Splats, sh_basis
from stylesplat.verbs.import_ import import_

COUNT, FRACTION = 40, 12
FRAMES = (  # of the enumeration, from 1 on; right and left, up and down, front and back
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)
DIRECTIONS = {  # in PLY's axes: x right, y down, z forward
    **{"R": (1, 0, 0), "D": (0, 1, 0), "F": (0, 0, 1)},
    **{"L": (-1, 0, 0), "U": (0, -1, 0), "B": (0, 0, -1)},
}
CENTRES = np.random.default_rng(0).uniform(-2, 2, (COUNT, 3))
IMAGINARY = np.random.default_rng(1).uniform(-0.5, 0.5, (COUNT, 3))  # of rotations


def packed(
    version: int, degree: int, places: np.ndarray = CENTRES, flags: int = 0, records: bytes = b""
) -> bytes:
    """The content of a file; higher bands are 128 + the number of their coefficient."""
    if version == 1:
        place = places.astype("<f2").tobytes()
    else:
        fixed = np.round(places * 2**FRACTION).astype("<i4")
        place = fixed.view("u1").reshape(COUNT, 3, 4)[:, :, :3].tobytes()
    real = np.sqrt(1 - (IMAGINARY**2).sum(axis=1))
    if version < 3:
        turn = np.round(IMAGINARY * 127.5 + 127.5).astype("u1").tobytes()
    else:  # here the real part is not always the largest
        quats, words = np.column_stack([IMAGINARY, real]), []
        for quat in quats:
            largest = int(np.abs(quat).argmax())
            word = largest
            for value in np.delete(quat * np.sign(quat[largest]), largest):
                word = word << 10 | (value < 0) << 9 | round(abs(value) * 2**0.5 * 511)
            words.append(word)
        turn = np.array(words, "<u4").tobytes()
    bands = np.tile(np.repeat(np.arange((degree + 1) ** 2 - 1), 3) + 128, COUNT).astype("u1")
    parts = [place, bytes([230]) * COUNT, bytes(range(120)), bytes([100]) * 3 * COUNT]
    parts += [turn, bands.tobytes()]
    flags |= 2 if records else 0
    head = struct.pack("<4sIIBBBB", b"NGSP", version, COUNT, degree, FRACTION, flags, 0)
    if version < 4:
        return gzip.compress(head + b"".join(parts) + records)
    streams = [zstandard.ZstdCompressor().compress(part) for part in parts if part]
    head = head[:15] + bytes([len(streams)]) + struct.pack("<I12x", 32 + len(records))
    table = [struct.pack("<QQ", len(s), len(p)) for s, p in zip(streams, parts, strict=False)]
    return head + records + b"".join(table + streams)


def record(kind: int, *numbers: int) -> bytes:
    return struct.pack(f"<II{len(numbers)}I", kind, 4 * len(numbers), *numbers)


def axes(name: str) -> bytes:
    return record(0xADBE0003, FRAMES.index(name) + 1)


@pytest.mark.parametrize("version", [1, 2, 3, 4])
@pytest.mark.parametrize("degree", range(5))
def test_all_versions_and_degrees(tmp_path: Path, said: list[str], version: int, degree: int):
    path = tmp_path / "a.spz"
    path.write_bytes(packed(version, degree))
    found = read_splats(path)
    expected = CENTRES * [1, -1, -1]  # a .spz has y up
    np.testing.assert_allclose(found.means, expected, atol=2e-3 if version == 1 else 2e-4)
    quats = np.column_stack([np.sqrt(1 - (IMAGINARY**2).sum(axis=1)), IMAGINARY * [1, -1, -1]])
    cosines = np.abs((found.quats.numpy() * quats).sum(axis=1))
    assert cosines.min() > (0.9999 if version < 3 else 0.999995)
    assert found.sh_degree == min(degree, 3)
    numbers = found.shN[0, :, 0].abs() * 128
    np.testing.assert_allclose(numbers, np.arange(min((degree + 1) ** 2, 16) - 1), atol=1e-5)
    assert len(said) == (degree == 4)
    assert all("degree 4: the bands above 3 are left out" in line for line in said)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("name", FRAMES)
def test_declared_axes(tmp_path: Path, said: list[str], version: int, name: str):
    """Places, shapes and colours from all sides are those of the file, seen in PLY's axes."""
    path = tmp_path / "a.spz"
    matrix = np.array([DIRECTIONS[letter] for letter in name]).T  # from the frame to PLY's
    path.write_bytes(packed(version, 3))
    plain = read_splats(path)  # of SPZ's own axes
    own = np.diag([1.0, -1.0, -1.0])
    path.write_bytes(packed(version, 3, records=axes(name)))
    found = read_splats(path)
    turn = torch.from_numpy(matrix @ own)
    np.testing.assert_allclose(found.means, plain.means.double() @ turn.T, atol=1e-6)
    shapes = [covariances(splats) for splats in (found, plain)]
    torch.testing.assert_close(shapes[0], turn @ shapes[1] @ turn.T, atol=1e-5, rtol=0)
    dirs = torch.nn.functional.normalize(randn(50, 3).double(), dim=1)
    seen = [colors(found, dirs), colors(plain, dirs @ turn)]
    torch.testing.assert_close(*seen, atol=1e-5, rtol=0)
    assert len(said) == (name != "RUB") and all(f"axes {name}" in line for line in said)


def covariances(splats: Splats) -> torch.Tensor:
    w, x, y, z = torch.nn.functional.normalize(splats.quats.double(), dim=1).unbind(dim=1)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    rotations = torch.stack(rows, dim=1).unflatten(1, (3, 3))
    sizes = torch.tensor([1.0, 2.0, 3.0]).double()  # those of the file are equal
    return rotations * sizes**2 @ rotations.mT


def colors(splats: Splats, dirs: torch.Tensor) -> torch.Tensor:
    bands = torch.cat([splats.sh0, splats.shN], dim=1).double()
    return torch.einsum("dk,nkc->ndc", sh_basis(3, dirs), bands)


def test_other_records_are_named(tmp_path: Path, said: list[str]):
    path = tmp_path / "a.spz"
    records = record(0x12340001, 1, 2, 3) + axes("RDF") + record(0xADBE0002, 0, 0, 0)
    path.write_bytes(packed(4, 0, records=records))
    np.testing.assert_allclose(read_splats(path).means, CENTRES, atol=2e-4)
    assert said[0] == f"{path} has records that are not read here: 0x12340001, 0xADBE0002."
    path.write_bytes(packed(3, 0, records=record(0xADBE0003, 0)))
    np.testing.assert_allclose(read_splats(path).means[:, 1], -CENTRES[:, 1], atol=2e-4)


@pytest.mark.parametrize(
    ("records", "expected"),
    [
        (record(0xADBE0003, 17), "axes of number 17, of which there are 16"),
        (struct.pack("<II", 0xADBE0003, 400), "record 0xADBE0003 ends after the file"),
    ],
)
def test_records_that_cannot_be(tmp_path: Path, records: bytes, expected: str):
    path = tmp_path / "a.spz"
    path.write_bytes(packed(4, 0, records=records))
    with pytest.raises(StyleSplatError, match=rf"a\.spz as splats: .*{expected}"):
        read_splats(path)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_the_mark_of_anti_aliasing(tmp_path: Path, version: int):
    path = tmp_path / "a.spz"
    path.write_bytes(packed(version, 1, flags=1))
    found = read_splats(path)
    assert found.antialiased
    write_splats(found, tmp_path / "b.spz", spz_version=version)
    assert read_splats(tmp_path / "b.spz").antialiased
    write_splats(replace(found, antialiased=False), tmp_path / "b.spz", spz_version=version)
    assert not read_splats(tmp_path / "b.spz").antialiased


PLACES = {  # formats that carry the mark on
    **{".ply": None, ".compressed.ply": None, ".spz": None, ".sog": None},
    **{".glb": 2, ".gltf": 2},  # with SPZ inside
}


@pytest.mark.parametrize(("suffix", "version"), PLACES.items())
def test_the_mark_is_carried_on(tmp_path: Path, said: list[str], suffix: str, version: int | None):
    splats, path = replace(random_splats(COUNT), antialiased=True), tmp_path / f"a{suffix}"
    write_splats(splats, path, spz_version=version)
    assert read_splats(path).antialiased and not said
    write_splats(replace(splats, antialiased=False), path, spz_version=version)
    assert not read_splats(path).antialiased


@pytest.mark.parametrize("suffix", [".splat", ".glb", ".gltf"])
def test_a_line_where_the_mark_has_no_place(tmp_path: Path, said: list[str], suffix: str):
    splats, path = replace(random_splats(COUNT), antialiased=True), tmp_path / f"a{suffix}"
    write_splats(splats, path)
    assert len(said) == 1 and f"{path} has no place for a mark" in said[0]


def test_scenes_keep_the_mark(tmp_path: Path):
    path = tmp_path / "a.spz"
    path.write_bytes(packed(4, 1, flags=1))
    save(import_(path), tmp_path / "scene")
    assert open_scene(tmp_path / "scene").splats.antialiased
