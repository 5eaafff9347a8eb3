import pytest
import torch
from octaves import octaves

MASK = torch.zeros(64, 96, dtype=torch.bool)
MASK[8:56, 8:88] = True


def waves(length: float) -> torch.Tensor:
    columns = torch.arange(96) * (2 * torch.pi / length)
    return (0.5 + 0.3 * columns.sin()).expand(64, 96)[..., None].expand(64, 96, 3)


@pytest.mark.parametrize(("length", "octave"), [(3, 0), (8, 1), (15, 2), (30, 3)])
def test_waves_are_in_the_octave_of_their_size(length: float, octave: int):
    energies = octaves(waves(length), MASK)
    assert max(range(4), key=energies.__getitem__) == octave


def test_what_is_around_does_not_count():
    image = waves(8)
    other = torch.where(MASK[..., None], image, torch.ones(3))
    assert octaves(other, MASK) == pytest.approx(octaves(image, MASK))
    flat = torch.where(MASK[..., None], torch.tensor(0.3), torch.ones(3))
    assert max(octaves(flat, MASK)) < 1e-10
