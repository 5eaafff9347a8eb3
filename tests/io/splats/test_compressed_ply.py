"""SuperSplat's compressed PLY as we write it, read by the description of the format."""

from pathlib import Path

import numpy as np
import pytest
import torch

from stylesplat.io.splats.compressed_ply import write_compressed_ply
from stylesplat.io.splats.packing import morton_order
from stylesplat.scene.splats import SH_C0, Splats

COUNT = 3000  # a dozen chunks, the last one incomplete


def a_cloud(bands: int) -> Splats:
    """A cube of ten units, and one Gaussian far away."""
    generator = torch.Generator().manual_seed(0)

    def random(*shape: int) -> torch.Tensor:
        return torch.randn(COUNT, *shape, generator=generator)

    means = 10 * torch.rand(COUNT, 3, generator=generator)
    means[7] = torch.tensor([900.0, -3.0, 4.0])
    colors = random(1, 3), 0.3 * random(bands, 3)
    return Splats(means, 3 * random(4), random(3) - 4, 2 * random(), *colors)


def unpacked(words: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Whole numbers from the highest bits of 32 to the lowest, as shares of their largest."""
    fields, shift = [], 32
    for width in bits:
        shift -= width
        fields.append((words >> shift & (1 << width) - 1) / ((1 << width) - 1))
    return np.stack(fields, axis=1)


def between(shares: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Values of a chunk's Gaussians, from its lowest and highest in x, y and z (or r, g, b)."""
    low, high = (bounds[np.arange(len(shares)) // 256, side : side + 3] for side in (0, 3))
    return low + shares * (high - low)


def rotations(words: np.ndarray) -> np.ndarray:
    """The three smaller parts of 10 bits, after the place of the largest, wxyz."""
    quats = np.zeros((len(words), 4))
    parts = (unpacked(words, (2, 10, 10, 10))[:, 1:] - 0.5) * np.sqrt(2)
    for row, (word, part) in enumerate(zip(words, parts, strict=True)):
        largest = int(word >> 30)
        others = [axis for axis in range(4) if axis != largest]
        quats[row, others] = part
        quats[row, largest] = np.sqrt(max(0.0, 1 - (part**2).sum()))
    return quats


@pytest.mark.parametrize("bands", [0, 3, 8, 15])
def test_every_number_is_as_near_as_its_bits_allow(tmp_path: Path, bands: int):
    splats = a_cloud(bands)
    write_compressed_ply(splats, tmp_path / "a.compressed.ply")
    content = (tmp_path / "a.compressed.ply").read_bytes()
    body = content[content.index(b"end_header\n") + 11 :]
    chunks = -(-COUNT // 256)
    bounds = np.frombuffer(body, "<f4", chunks * 18).reshape(chunks, 18)
    packed = np.frombuffer(body, "<u4", COUNT * 4, bounds.nbytes).reshape(COUNT, 4)
    order = morton_order(splats.means)
    ours = splats[order]
    # Half a step, of 2047 or 1023 between a chunk's bounds; the last bits are of float32
    rows = np.arange(COUNT) // 256
    for column, (expected, first) in {0: (ours.means, 0), 2: (ours.scales, 6)}.items():
        found = between(unpacked(packed[:, column], (11, 10, 11)), bounds[:, first : first + 6])
        extent = bounds[rows, first + 3 : first + 6] - bounds[rows, first : first + 3]
        steps = extent / np.array([2047, 1023, 2047])
        assert (np.abs(found - expected.numpy()) <= 0.501 * steps + 1e-4).all()
    colors = unpacked(packed[:, 3], (8, 8, 8, 8))
    found = between(colors[:, :3], bounds[:, 12:])
    steps = (bounds[rows, 15:] - bounds[rows, 12:15]) / 255
    assert (np.abs(found - (0.5 + SH_C0 * ours.sh0[:, 0].numpy())) <= 0.501 * steps + 1e-6).all()
    assert np.abs(colors[:, 3] - ours.opacities.sigmoid().numpy()).max() <= 0.501 / 255
    turned = torch.nn.functional.normalize(ours.quats, dim=1).numpy()
    same = np.abs((rotations(packed[:, 1]) * turned).sum(axis=1))
    assert same.min() > 1 - 1e-5  # three parts within 0.0007 each
    higher = np.frombuffer(body, np.uint8, -1, bounds.nbytes + packed.nbytes)
    found = ((higher.reshape(COUNT, 3 * bands) + 0.5) / 256 - 0.5) * 8
    expected = ours.shN.mT.flatten(1).numpy()
    assert np.abs(found - expected).max(initial=0) <= 0.501 / 32


def test_an_order_in_which_neighbours_follow_each_other():
    corners = torch.cartesian_prod(*[torch.tensor([0.0, 1.0, 8.0, 9.0])] * 3)
    shuffled = corners[torch.randperm(64, generator=torch.Generator().manual_seed(0))]
    for octant in shuffled[morton_order(shuffled)].split(8):  # each is done before the next begins
        assert (octant.amax(dim=0) - octant.amin(dim=0)).tolist() == [1, 1, 1]
    assert morton_order(torch.zeros(3, 3)).tolist() == [0, 1, 2]
    assert not len(morton_order(torch.zeros(0, 3)))
