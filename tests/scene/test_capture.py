from dataclasses import replace
from typing import Any

import pytest
import torch
from jaxtyping import config

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, at_most, fingerprint
from stylesplat.scene.sequences import Lazy

NOISE = torch.Generator().manual_seed(0)
PHOTOS = [torch.randint(256, (36, 48, 3), generator=NOISE).to(torch.uint8) for _ in range(8)]
MAPS = [torch.randint(9, (36, 48), generator=NOISE) for _ in range(8)]
CAPTURE = Capture(
    cameras=CAMERAS,
    photos=PHOTOS,
    label_maps=MAPS,
    points=SPLATS.means,
    point_colors=torch.zeros(len(SPLATS), 3, dtype=torch.uint8),
    object_names={3: "vase"},
    alphas=[*(torch.full((36, 48), 255, dtype=torch.uint8) for _ in range(8))],
    valid_masks=[*(torch.eye(36, 48) > 0 for _ in range(7)), None],
    held_out=frozenset(CAMERAS.names[:2]),
)


def test_some_of_the_photos():
    some = CAPTURE.only([5, 2])
    assert some.cameras.names == (CAMERAS.names[5], CAMERAS.names[2])
    assert some.photos[1] is PHOTOS[2] and some.labels(0) is MAPS[5]
    assert some.alpha(0) is CAPTURE.alpha(5) is not None
    assert some.valid(0) is CAPTURE.valid(5) is not None
    with pytest.raises(StyleSplatError, match="Expected 8 label maps, one per camera, got 7"):
        replace(CAPTURE, label_maps=MAPS[:7])


def changed(tensor: torch.Tensor) -> torch.Tensor:
    """The same but for one number."""
    other = tensor.clone()
    other.view(-1)[7] += 1
    return other


@pytest.mark.parametrize(
    "changes",
    [
        {"cameras": replace(CAMERAS, names=("x.jpg", *CAMERAS.names[1:]))},
        {"cameras": replace(CAMERAS, viewmats=changed(CAMERAS.viewmats))},
        {"points": changed(SPLATS.means)},
        {"label_maps": [*MAPS[:2], changed(MAPS[2]), *MAPS[3:]]},
        {"label_maps": [*MAPS[:7], None]},
        {"object_names": {3: "pot"}},
        {"photos": [*map(changed, PHOTOS)]},
        {"alphas": None},
        {"valid_masks": [None] * 8},
        {"held_out": None},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_each_part_changes_the_fingerprint(changes: dict[str, Any]):
    assert fingerprint(CAPTURE) == fingerprint(replace(CAPTURE))
    assert fingerprint(CAPTURE) != fingerprint(replace(CAPTURE, **changes))


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
    mask = torch.arange(40).expand(20, 40) > 6
    photos, maps = [photo(0), photo(1)], [labels(0), None]
    return Capture(cameras, photos, label_maps=maps, valid_masks=[mask, None])


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
    mask = small.valid(0)
    assert mask is not None and torch.equal(mask, (torch.arange(10) > 1).expand(5, 10))
    assert small.valid(1) is None


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
    twice = at_most(at_most(two_photos(), 20), 10)
    assert twice.downscale == 4 and twice.full_cameras.sizes.tolist() == [*map(list, SIZES)]
    assert at_most(twice, 40) is twice, "it is small enough"
