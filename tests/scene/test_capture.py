from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from jaxtyping import config

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.scene.cache import Lazy
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, at_most, differences, fingerprint

PHOTO = torch.zeros(36, 48, 3, dtype=torch.uint8)
CAPTURE = Capture(CAMERAS, [PHOTO] * 8)


@pytest.mark.parametrize(
    ("field", "items"),
    [("photos", [PHOTO] * 7), ("label maps", [None] * 7), ("alphas", [None] * 7)],
)
def test_one_of_each_per_camera(field: str, items: list):
    with pytest.raises(StyleSplatError, match=f"Expected 8 {field}, one per camera, got 7"):
        replace(CAPTURE, **{field.replace(" ", "_"): items})


def test_label_maps_and_alphas_of_single_photos():
    maps = [torch.full((36, 48), row) if row else None for row in range(8)]
    alphas = [torch.full((36, 48), row, dtype=torch.uint8) if row else None for row in range(8)]
    both = replace(CAPTURE, label_maps=maps, alphas=alphas)
    assert both.labels(0) is None and both.alpha(0) is None
    assert both.labels(3) is maps[3] and both.alpha(3) is alphas[3]


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
)


def changed(tensor: torch.Tensor) -> torch.Tensor:
    """The same but for one number."""
    other = tensor.clone()
    other.view(-1)[7] += 1
    return other


def one_changed(items) -> list:
    return [*items[:2], changed(items[2]), *items[3:]]


CHANGES: dict[str, Callable[[], tuple[Capture, str]]] = {
    "a name": lambda: (
        replace(CAPTURE, cameras=replace(CAMERAS, names=("x.jpg", *CAMERAS.names[1:]))),
        "other photos",
    ),
    "a size": lambda: (
        replace(CAPTURE, cameras=replace(CAMERAS, sizes=changed(CAMERAS.sizes))),
        "photos of another size",
    ),
    "a focal length": lambda: (
        replace(CAPTURE, cameras=replace(CAMERAS, Ks=changed(CAMERAS.Ks))),
        "other poses",
    ),
    "a pose": lambda: (
        replace(CAPTURE, cameras=replace(CAMERAS, viewmats=changed(CAMERAS.viewmats))),
        "other poses",
    ),
    "a point": lambda: (replace(CAPTURE, points=changed(SPLATS.means)), "other points"),
    "a point's colour": lambda: (
        replace(CAPTURE, point_colors=changed(torch.zeros(len(SPLATS), 3, dtype=torch.uint8))),
        "other points",
    ),
    "no points": lambda: (replace(CAPTURE, points=None, point_colors=None), "other points"),
    "a label": lambda: (replace(CAPTURE, label_maps=one_changed(MAPS)), "other label maps"),
    "a map less": lambda: (replace(CAPTURE, label_maps=[*MAPS[:7], None]), "other label maps"),
    "no maps": lambda: (replace(CAPTURE, label_maps=None), "other label maps"),
    "an object's name": lambda: (
        replace(CAPTURE, object_names={3: "pot"}),
        "other names of objects",
    ),
    "photos": lambda: (
        replace(CAPTURE, photos=[*map(changed, PHOTOS)]),
        "photos with other content",
    ),
    "no alphas": lambda: (replace(CAPTURE, alphas=None), "photos with other content"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_each_ingredient_counts_and_is_named(what: str):
    other, named = CHANGES[what]()
    assert differences(fingerprint(CAPTURE), fingerprint(other)) == [named]


def test_where_and_how_a_capture_is_kept_does_not_count():
    moved = replace(
        CAPTURE,
        path=Path("/elsewhere"),
        photos=Lazy([lambda photo=photo: photo.clone() for photo in PHOTOS]),
        label_maps=[labels.int() for labels in MAPS],
        object_names=dict(CAPTURE.object_names),
    )
    assert fingerprint(moved) == fingerprint(CAPTURE)


def test_a_label_counts_wherever_it_is():
    marks = set()
    for row in range(8):
        maps = [changed(labels) if i == row else labels for i, labels in enumerate(MAPS)]
        marks.add(fingerprint(replace(CAPTURE, label_maps=maps)))
    assert len(marks) == 8 and fingerprint(CAPTURE) not in marks


def test_only_a_few_photos_are_read():
    read: list[int] = []

    def reader(row: int):
        return lambda: (read.append(row), PHOTOS[row])[1]

    capture = replace(CAPTURE, photos=Lazy([reader(row) for row in range(8)]))
    read.clear()  # types are checked by looking at some
    fingerprint(capture, photos=3)
    assert read == [1, 4, 6]


def test_another_size_is_the_only_thing_told():
    # Photos, label maps and intrinsics of another size differ too, but nobody needs to hear it.
    small = replace(
        CAPTURE,
        cameras=CAMERAS.downscale(2),
        photos=[photo[::2, ::2].contiguous() for photo in PHOTOS],
        label_maps=[labels[::2, ::2].contiguous() for labels in MAPS],
        alphas=None,
    )
    told = differences(fingerprint(CAPTURE), fingerprint(small))
    assert told == ["photos of another size"]


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
