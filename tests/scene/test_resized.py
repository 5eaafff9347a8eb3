from dataclasses import replace

import pytest
import torch
from jaxtyping import config

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import ids_of
from stylesplat.scene.lazy import Lazy
from stylesplat.scene.resized import at_most

SIZES = ((40, 20), (20, 40))  # width and height


def photo(row: int) -> torch.Tensor:
    width, height = SIZES[row]
    generator = torch.Generator().manual_seed(row)
    return torch.randint(256, (height, width, 3), generator=generator, dtype=torch.uint8)


def labels(row: int) -> torch.Tensor:
    """One object on the left, 70,000 on the right."""
    width, height = SIZES[row]
    return torch.where(torch.arange(width) < width // 2, 3, 70_000).expand(height, width)


def two_photos() -> Capture:
    K = torch.tensor([[30.0, 0.0, 20.0], [0.0, 30.0, 10.0], [0.0, 0.0, 1.0]])
    cameras = Cameras(
        torch.eye(4).expand(2, 4, 4), K.expand(2, 3, 3), torch.tensor(SIZES), ("a.jpg", "b.jpg")
    )
    return Capture(cameras, [photo(0), photo(1)], label_maps=[labels(0), None])


def test_all_that_belongs_to_photos_becomes_smaller():
    whole, small = two_photos(), at_most(two_photos(), 10)
    assert small.cameras.sizes.tolist() == [[10, 5], [5, 10]]
    assert torch.allclose(small.cameras.Ks[:, :2] * 4, whole.cameras.Ks[:, :2])
    for row in range(2):
        blocks = whole.photos[row].float().unfold(0, 4, 4).unfold(1, 4, 4).mean(dim=(3, 4))
        assert (small.photos[row].float() - blocks).abs().max() <= 0.5, "averages, but for rounding"
    assert small.label_maps is not None and small.label_maps[1] is None
    assert small.label_maps[0] is not None
    assert torch.equal(small.label_maps[0], labels(0)[::4, ::4])


def test_a_capture_that_is_small_enough_stays_as_it_is():
    whole = two_photos()
    assert at_most(whole, 40) is whole


def test_it_is_taken_as_it_is_without_label_maps():
    assert at_most(replace(two_photos(), label_maps=None), 10).label_maps is None


def test_photos_are_read_once(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(config, "jaxtyping_disable", True)  # type checks look at photos
    read: list[int] = []

    def make() -> torch.Tensor:
        read.append(0)
        return photo(0)

    whole = replace(two_photos(), photos=Lazy([make, make]))
    small = at_most(whole, 20)
    assert not read, "on access"
    assert small.photos[0] is small.photos[0] and len(read) == 1, "kept"
    assert at_most(small, 10).photos[0].shape == (5, 10, 3) and len(read) == 1


def test_it_knows_the_size_of_the_photos():
    small = at_most(at_most(two_photos(), 20), 10)
    assert small.downscale == 4 and small.full_cameras.sizes.tolist() == [*map(list, SIZES)]


def test_ids_of_a_label_map():
    assert ids_of(labels(0)) == {*labels(0).unique().tolist()}
    assert ids_of(torch.zeros(3, 4, dtype=torch.int32)) == {0}
    assert ids_of(None) == set()
