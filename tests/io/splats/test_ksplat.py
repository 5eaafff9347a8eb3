import struct
from pathlib import Path

import pytest

from ksplat_files import BLOCK, HIGH, LOW, write_ksplat
from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.packing import unit_quats
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.scene.splats import SH_C0, Splats

COUNT = 30


def cloud(seed: int) -> Splats:
    splats = random_splats(COUNT, seed=seed, sh_degree=2)
    splats.means.clamp_(-2, 2)  # a bucket's cube
    splats.shN.clamp_(LOW, HIGH)
    return splats


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_sections_are_read_one_after_the_other(tmp_path: Path, level: int, degree: int):
    parts = [cloud(0), cloud(1)]
    found = read_splats(write_ksplat(tmp_path / "a.ksplat", parts, level, degree))
    assert len(found) == 2 * COUNT and found.sh_degree == degree
    wanted = Splats.cat(parts)
    half = 0 if level == 0 else 5e-4  # a share of a number that is stored as a half float
    assert (found.means - wanted.means).abs().max() <= (
        1e-6 if level == 0 else 1.01 * BLOCK / 2**17
    )
    assert (found.scales - wanted.scales).abs().max() <= 1e-6 + half
    assert (found.quats - unit_quats(wanted.quats)).abs().max() <= 1e-6 + half
    opacities = (found.opacities.sigmoid() - wanted.opacities.sigmoid()).abs()
    colors = (found.sh0 * SH_C0 + 0.5 - (wanted.sh0 * SH_C0 + 0.5).clamp(0, 1)).abs()
    assert opacities.max() <= 1 / 255 and colors.max() <= 1.001 / 255
    step = {0: 1e-6, 1: 1e-3, 2: 1.001 * (HIGH - LOW) / 255}[level]
    bands = (degree + 1) ** 2 - 1
    assert found.shN.shape[1] == bands
    assert bands == 0 or (found.shN - wanted.shN[:, :bands]).abs().max() <= step


@pytest.mark.parametrize(
    ("offset", "kind", "value", "expected"),
    [
        (1, "<B", 0, "version 0.0"),
        (20, "<H", 3, "level of compression is 3"),
        (16, "<I", 4_000_000_000, "60 Gaussians instead of 4000000000"),
        (4, "<I", 2**31, "requires a buffer|offset"),
        (4096 + 4, "<I", 2**31, "smaller than requested"),
        (4096 + 8, "<I", 9, "buckets do not hold as many"),
        (4096 + 12, "<I", 2**31, "offset|smaller than requested"),
        (4096 + 32, "<I", 2**31, "buckets do not hold as many"),
        (4096 + 40, "<H", 4, "colours of degree 4"),
    ],
)
def test_counts_that_do_not_fit(tmp_path: Path, offset: int, kind: str, value: int, expected: str):
    path = write_ksplat(tmp_path / "a.ksplat", [cloud(0), cloud(1)], 1, 1)
    content = bytearray(path.read_bytes())
    struct.pack_into(kind, content, offset, value)
    path.write_bytes(content)
    with pytest.raises(StyleSplatError, match=expected) as caught:
        read_splats(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_that_is_cut_off(tmp_path: Path):
    path = write_ksplat(tmp_path / "a.ksplat", [cloud(0)], 2, 2)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(StyleSplatError, match="smaller than requested"):
        read_splats(path)


def test_a_file_without_sections_is_refused(tmp_path: Path):
    with pytest.raises(StyleSplatError, match="no part with Gaussians"):
        read_splats(write_ksplat(tmp_path / "a.ksplat", [], 1, 1))
