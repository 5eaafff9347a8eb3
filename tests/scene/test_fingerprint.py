from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.scene.capture import Capture
from stylesplat.scene.fingerprint import differences, fingerprint
from stylesplat.scene.lazy import Lazy

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
        "photos that look otherwise",
    ),
    "no alphas": lambda: (replace(CAPTURE, alphas=None), "photos that look otherwise"),
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


def test_the_order_of_names_of_objects_does_not_count():
    one = replace(CAPTURE, object_names={1: "a", 2: "b"})
    other = replace(CAPTURE, object_names={2: "b", 1: "a"})
    assert fingerprint(one) == fingerprint(other)


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


def test_several_differences_are_all_told():
    other = replace(CAPTURE, points=None, point_colors=None, label_maps=None)
    assert differences(fingerprint(CAPTURE), fingerprint(other)) == [
        "other points",
        "other label maps",
    ]
