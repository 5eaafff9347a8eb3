import gzip
import struct
from dataclasses import replace
from pathlib import Path

import gsply
import pytest
import torch
import zstandard

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.splats import Splats
from stylesplat.verbs.export import export

SHARED = Path(__file__).parents[3] / "shared" / "data" / "splats"
PLAIN = replace(SPLATS, identities=None, classifier=None)
needs_samples = pytest.mark.skipif(not SHARED.is_dir(), reason="the sample files are not here")


def with_bands(count: int) -> Splats:
    generator = torch.Generator().manual_seed(0)
    return replace(PLAIN, shN=0.1 * torch.randn(len(PLAIN), count, 3, generator=generator))


def difference(one: Splats, other: Splats) -> float:
    images = [rasterize(splats, CAMERAS[0], backend="reference")[0] for splats in (one, other)]
    return float((images[0] - images[1]).abs().mean())


def compressed(splats: Splats, path: Path) -> Path:
    """As SuperSplat writes it."""
    data = gsply.GSData(
        means=splats.means.numpy(),
        scales=splats.scales.numpy(),
        quats=torch.nn.functional.normalize(splats.quats, dim=1).numpy(),
        opacities=splats.opacities.numpy(),
        sh0=splats.sh0[:, 0].numpy(),
        shN=splats.shN.numpy(),
    )
    gsply.plywrite(path, data, compressed=True)
    (written,) = path.parent.glob(f"{path.stem}*")
    return written.rename(path)


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


def _facing(splats: Splats) -> Cameras:
    """A camera in front of all of it."""
    middle = splats.means.mean(dim=0)
    away = 3 * float((splats.means - middle).norm(dim=1).max()) + 1
    position = (middle - torch.tensor([0.0, 0.0, away]))[None]
    K = torch.tensor([[[64.0, 0, 32], [0, 64, 32], [0, 0, 1]]])
    viewmats = look_at(position, middle, torch.tensor([0.0, -1.0, 0.0]))
    return Cameras(viewmats, K, torch.tensor([[64, 64]]), ("a",))


@needs_samples
def test_samples_of_other_programs_agree():
    found = [
        read_splats(SHARED / "metalsplatter" / f"test-splat.3-points-from-train{suffix}")
        for suffix in (".ply", ".splat", ".spz")
    ]
    ply, splat, spz = found
    images = [rasterize(replace(s, shN=s.shN[:, :0]), _facing(ply))[0] for s in found]
    assert images[0].max() > 0.05
    assert max(float((image - images[0]).abs().max()) for image in images) < 0.05
    for other in (splat, spz):
        nearest = torch.cdist(other.means, ply.means).min(dim=1).values
        assert nearest.max() < 0.01
        assert len(other) == 3
    assert spz.sh_degree == ply.sh_degree


@needs_samples
@pytest.mark.parametrize("version", [3, 4])
def test_samples_of_spz_versions(version: int):
    folder = SHARED / "splat_transform_fixtures"
    splats = read_splats(folder / f"minimal-v{version}.spz")
    other = read_splats(folder / "minimal.splat")
    torch.testing.assert_close(splats.means, other.means)
    assert (splats.sh0 - other.sh0).abs().max() < 0.01  # 8 bits each
    assert (splats.opacities - other.opacities).abs().max() < 0.01


def spz(content: bytes, path: Path) -> Path:
    path.write_bytes(gzip.compress(content))
    return path


def spz_header(count: int, degree: int = 0) -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", 2, count, degree, 12, 0, 0)


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
    with pytest.raises(StyleSplatError, match="no SPZ header"):
        read_splats(path)


@needs_samples
def test_hostile_spz_of_version_4(tmp_path: Path):
    content = (SHARED / "splat_transform_fixtures" / "minimal-v4.spz").read_bytes()
    (tmp_path / "a.spz").write_bytes(content[:0x70] + b"!" + content[0x71:])
    with pytest.raises(StyleSplatError, match="Cannot read"):
        read_splats(tmp_path / "a.spz")
    start = 0x70  # where the streams are, after the table
    bomb = zstandard.ZstdCompressor().compress(bytes(10**7))
    table = struct.pack("<QQ", len(bomb), 36) + content[0x30:start]
    (tmp_path / "a.spz").write_bytes(content[:0x20] + table + bomb)
    with pytest.raises(StyleSplatError, match="holds more than its header says"):
        read_splats(tmp_path / "a.spz")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (b"element vertex 440", b"element vertex 4000000000", "chunks and vertices do not fit"),
        (b"element chunk 2", b"element chunk 9", "chunks and vertices do not fit"),
        (b"property float min_x", b"property double min_x", "other types"),
    ],
)
def test_hostile_compressed_ply(tmp_path: Path, old: bytes, new: bytes, expected: str):
    path = compressed(PLAIN, tmp_path / "a.ply")
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new))
    with pytest.raises(StyleSplatError, match=expected):
        read_splats(path)


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply"])
def test_bytes_too_many(tmp_path: Path, suffix: str, said: list[str]):
    path = tmp_path / f"a{suffix}"
    export(PLAIN, path)
    before = read_splats(path)
    path.write_bytes(path.read_bytes() + b"more")
    assert torch.equal(read_splats(path).means, before.means)
    assert len(said) == 1 and "goes on for 4 bytes after what its header announces" in said[0]


def test_no_whole_number_of_rows(tmp_path: Path):
    path = tmp_path / "a.splat"
    export(PLAIN, path)
    path.write_bytes(path.read_bytes() + b"more")
    with pytest.raises(StyleSplatError, match=r"Cannot read .*a\.splat: "):
        read_splats(path)


def test_numbers_that_are_not_finite(tmp_path: Path):
    means = PLAIN.means.clone()
    means[3, 1], means[5, 0] = float("nan"), float("inf")
    for suffix in (".ply", ".splat"):
        export(replace(PLAIN, means=means), tmp_path / f"a{suffix}")
        with pytest.raises(StyleSplatError, match="2 values of means are not finite"):
            read_splats(tmp_path / f"a{suffix}")


def test_nothing_to_read(tmp_path: Path):
    for name in ("a.ply", "a.spz", "a.splat", "a.glb", "a.gltf", "a.sog", "meta.json"):
        with pytest.raises(StyleSplatError, match=f"There is no file .*{name}. Check the name"):
            read_splats(tmp_path / name)
    (tmp_path / "a.obj").touch()
    with pytest.raises(StyleSplatError, match=r"suffix '.obj'.* Give one that ends in .ply, .spz"):
        read_splats(tmp_path / "a.obj")
    (tmp_path / "a.splat").write_bytes(b"")
    with pytest.raises(StyleSplatError, match="There are no Gaussians"):
        read_splats(tmp_path / "a.splat")
