import gzip
import struct
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import zstandard

from balls import CAMERAS, SPLATS
from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.verbs.export import export

PLAIN = replace(SPLATS, identities=None, classifier=None)


def with_bands(count: int) -> Splats:
    generator = torch.Generator().manual_seed(0)
    return replace(PLAIN, shN=0.1 * torch.randn(len(PLAIN), count, 3, generator=generator))


def difference(one: Splats, other: Splats) -> float:
    images = [rasterize(splats, CAMERAS[0], backend="reference")[0] for splats in (one, other)]
    return float((images[0] - images[1]).abs().mean())


@pytest.mark.parametrize("bands", [0, 3, 8, 15])
@pytest.mark.parametrize("suffix", [".ply", ".spz", ".splat", ".sog", ".compressed.ply", ".glb"])
def test_what_is_exported_is_read_back(tmp_path: Path, suffix: str, bands: int):
    splats, path = with_bands(bands), tmp_path / f"a{suffix}"
    export(splats, path)
    found = read_splats(path)
    assert len(found) == len(splats)
    expected = splats if suffix != ".splat" else replace(splats, shN=splats.shN[:, :0])
    # .spz, .splat and .sog keep 8 bits of colour, opacity and rotation; in a chunk of
    # .compressed.ply positions have 11 bits of a fifth of the scene; of 440 random bands, .sog
    # has a palette of 256
    most = {".ply": 1e-6, ".glb": 1e-6, ".sog": 0.02}.get(suffix, 0.01)
    assert difference(found, expected) < most


def spz(content: bytes, path: Path) -> Path:
    path.write_bytes(gzip.compress(content))
    return path


def spz_header(count: int, degree: int = 0) -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", 2, count, degree, 12, 0, 0)


@pytest.mark.parametrize(("version", "degrees"), [(4, 0.3), (3, 0.3), (2, 1.3)])
def test_all_versions_of_spz(version: int, degrees: float, tmp_path: Path):
    splats = random_splats(300)
    splats = replace(splats, shN=splats.shN.clamp(-0.9, 0.9))  # SPZ clips at 1
    path = tmp_path / "a.spz"
    write_splats(splats, path, spz_version=version)
    content = path.read_bytes()
    head = content if version == 4 else gzip.decompress(content)
    assert head[:8] == b"NGSP" + version.to_bytes(4, "little")
    found = read_splats(path)
    for name, most in (("means", 1e-5), ("scales", 0.04), ("shN", 0.05)):
        assert (getattr(found, name) - getattr(splats, name)).abs().max() < most, name
    axes, others = (rotation_matrices(s.quats).double() for s in (found, splats))
    cosines = (axes * others).sum(dim=1).abs()  # half a turn about an axis changes no Gaussian
    assert cosines.min().clamp(max=1).acos().rad2deg() < degrees
    with pytest.raises(StyleSplatError, match=r"a\.ply is no SPZ"):
        write_splats(splats, tmp_path / "a.ply", spz_version=version)
    with pytest.raises(StyleSplatError, match="version of SPZ"):
        write_splats(splats, path, spz_version=1)


def test_hostile_spz(tmp_path: Path):
    path = tmp_path / "a.spz"
    with pytest.raises(StyleSplatError, match=r"claims 4000000000 Gaussians, which \d+ bytes"):
        read_splats(spz(spz_header(4_000_000_000), path))
    with pytest.raises(StyleSplatError, match="Cannot read"):
        read_splats(spz(spz_header(4) + bytes(19), path))  # one of four
    with pytest.raises(StyleSplatError, match="holds more than its header says"):
        read_splats(spz(spz_header(1) + bytes(3 * 2**20), path))
    path.write_bytes(gzip.compress(spz_header(1) + bytes(19)) + gzip.compress(bytes(10**6)))
    with pytest.raises(StyleSplatError, match="holds more than its header says"):
        read_splats(path)
    export(PLAIN, path, overwrite=True)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(StyleSplatError, match="Cannot read"):
        read_splats(path)
    path.write_bytes(b"no splat at all, of no kind")
    with pytest.raises(StyleSplatError, match="it is text, which begins 'no splat at all"):
        read_splats(path)


def test_hostile_spz_of_version_4(tmp_path: Path):
    path = tmp_path / "a.spz"
    export(PLAIN, path)
    content = path.read_bytes()
    (start,) = struct.unpack_from("<I", content, 16)  # where the table of streams is
    bomb = zstandard.ZstdCompressor().compress(bytes(10**7))
    size, unpacked = struct.unpack_from("<QQ", content, start)
    table = struct.pack("<QQ", len(bomb), unpacked)
    rest = content[start + 16 :]
    first = len(rest) - sum(
        struct.unpack_from("<QQ", content, start + 16 * n)[0] for n in range(content[15])
    )
    path.write_bytes(content[:start] + table + rest[:first] + bomb + rest[first + size :])
    with pytest.raises(StyleSplatError, match="holds more than its header says"):
        read_splats(path)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (b"element vertex 440", b"element vertex 4000000000", "chunks and vertices do not fit"),
        (b"element chunk 2", b"element chunk 9", "chunks and vertices do not fit"),
        (b"property float min_x", b"property double min_x", "other types"),
    ],
)
def test_hostile_compressed_ply(tmp_path: Path, old: bytes, new: bytes, expected: str):
    path = tmp_path / "a.compressed.ply"
    export(PLAIN, path)
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new))
    with pytest.raises(StyleSplatError, match=expected):
        read_splats(path)


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply", ".glb"])
def test_what_follows_the_gaussians_is_not_read(tmp_path: Path, suffix: str):
    path = tmp_path / f"a{suffix}"
    export(PLAIN, path)
    before = read_splats(path)
    path.write_bytes(path.read_bytes() + b"more")
    assert torch.equal(read_splats(path).means, before.means)


def test_nothing_to_read(tmp_path: Path):
    for name in ("a.ply", "a.spz", "a.splat", "a.ksplat", "a.glb", "a.gltf", "a.sog", "meta.json"):
        with pytest.raises(StyleSplatError, match=f"There is no file .*{name}. Check the name"):
            read_splats(tmp_path / name)
    (tmp_path / "a.obj").touch()
    with pytest.raises(StyleSplatError, match=r"a.obj is a file.* Give one that ends in .ply"):
        read_splats(tmp_path / "a.obj")
    (tmp_path / "a.splat").write_bytes(b"")
    with pytest.raises(StyleSplatError, match="it is empty"):
        read_splats(tmp_path / "a.splat")
