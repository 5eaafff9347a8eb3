"""Training photos and label classes: which there are, and at every size the schedule asks for."""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from threading import Lock
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Integer, UInt8
from torch import Tensor

from stylesplat.errors import join_names
from stylesplat.photo_libraries import cv2
from stylesplat.progress import say, track
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, Capture, ids_of, resize_labels, shrink_mask
from stylesplat.scene.sequences import GIB, Cache
from stylesplat.training.config import TrainConfig

VIEW_KEPT = 1.0  # GiB, unless the settings say otherwise: 200 photos of 1.5 megapixels
# Photos decoded in advance for a GPU, by as many threads: each takes up to two steps
VIEW_AHEAD = 4
VIEW_COARSER = 1.25  # what half the size takes in addition to the whole, while both are kept


class TrainingView(NamedTuple):
    """What one step learns from, on the device."""

    camera: Cameras
    """Of the photo's size."""
    photo: Float[Tensor, "H W 3"]
    """In 0..1, over black."""
    alpha: Float[Tensor, "H W 1"] | None
    """How opaque it is; None if it is everywhere."""
    classes: Integer[Tensor, "H W"] | None
    """The class of each pixel, in the smallest type; None without a label map."""
    valid: Bool[Tensor, "H W"] | None
    """The pixels to learn from; None if they are all."""


class PhotoPixels(NamedTuple):
    """The same as it is kept, in bytes: 255 is white, and opaque."""

    photo: UInt8[Tensor, "H W 3"]
    alpha: UInt8[Tensor, "H W"] | None
    classes: Integer[Tensor, "H W"] | None
    valid: Bool[Tensor, "H W"] | None


def split_views(capture: Capture, test_every: int) -> tuple[list[int], list[int]]:
    """Rows to train on and rows held out: every `test_every`-th, none if that is 0.

    By default the photos that the capture's files hold out, if they say so. Outliers that were left
    out are counted too, so that the others are split as with them.
    """
    rows, declared, left_out = range(len(capture)), capture.held_out, capture.outliers.rows
    if declared is not None and test_every == TrainConfig.test_every:
        held_out = [row for row in rows if capture.cameras.names[row] in declared]
    elif test_every == 0 or len(rows) < 2:
        held_out = []
    else:
        places = [place for place in range(len(rows) + len(left_out)) if place not in left_out]
        every = [row for row in rows if places[row] % test_every == 0]
        held_out = every or [*rows[::test_every]]
    return [row for row in rows if row not in held_out], held_out


class TrainingViews:
    """Loads some rows' views; keeps what fits, of one size at a time, in main memory.

    If all photos fit at full size they are decoded once, and smaller ones made of what is kept.
    For a GPU, threads decode into pinned memory the photos that are asked for in advance.
    """

    def __init__(
        self,
        capture: Capture,
        rows: Sequence[int],
        *,
        ids: tuple[int, ...],
        device: torch.device,
        max_memory: float | None = None,
    ) -> None:
        """`ids` are the label ids of the classes; `max_memory` is that of `TrainConfig`."""
        room = int((VIEW_KEPT if max_memory is None else max_memory) * GIB)
        self._capture, self._ids, self._device = capture, ids, device
        self._cache: Cache[tuple[int, int]] = Cache(room)
        self._all_fit = VIEW_COARSER * sum(_bytes(capture, row, ids) for row in rows) <= room
        self._latest, self._lock = 1, Lock()
        self._pool = ThreadPoolExecutor(VIEW_AHEAD, "photo") if device.type == "cuda" else None
        self._expected: dict[tuple[int, int], Future[PhotoPixels]] = {}

    def __call__(self, row: int, factor: int) -> TrainingView:
        """The view of a row of the capture, at a downscale."""
        expected = self._expected.pop((row, factor), None)
        pixels = self._pixels(row, factor) if expected is None else expected.result()
        camera = self._capture.cameras[row].downscale(factor)
        return _on(self._device, camera, pixels)

    def expect(self, row: int, factor: int) -> None:
        """Begin to load a view on a thread, if it goes to a GPU; of too many drop the oldest."""
        if self._pool is None or (row, factor) in self._expected:
            return
        while len(self._expected) >= VIEW_AHEAD:
            self._expected.pop(next(iter(self._expected))).cancel()
        self._expected[row, factor] = self._pool.submit(self._pixels, row, factor)

    def end(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def _pixels(self, row: int, factor: int) -> PhotoPixels:
        """The pixels of a view, pinned for a GPU."""
        with self._lock:  # threads ask at the same time
            if factor != self._latest:
                self._latest, kept = factor, {1, factor} if self._all_fit else {factor}
                self._cache.forget(lambda key: key[1] not in kept)
        pixels = self._kept(row, factor)
        if self._pool is None:
            return pixels
        photo, *others = pixels
        return PhotoPixels(
            photo.pin_memory(), *(None if t is None else t.pin_memory() for t in others)
        )

    def _kept(self, row: int, factor: int) -> PhotoPixels:
        def make() -> PhotoPixels:
            if factor == 1:
                return _read(self._capture, row, self._ids)
            whole = self._kept(row, 1) if self._all_fit else _read(self._capture, row, self._ids)
            return _resized(whole, self._capture.cameras[row].downscale(factor).size)

        return self._cache.get((row, factor), make)


def _bytes(capture: Capture, row: int, ids: tuple[int, ...]) -> int:
    """Of a photo with its label map; nothing is read."""
    width, height = capture.cameras[row].size
    others = sum(each is not None for each in (capture.alphas, capture.valid_masks))
    return width * height * (3 + others + (class_type(len(ids)).itemsize if ids else 0))


def _read(capture: Capture, row: int, ids: tuple[int, ...]) -> PhotoPixels:
    labels = capture.labels(row) if ids else None
    classes = None
    if labels is not None:  # all of them are among the ids, which ascend
        known = torch.tensor(ids, dtype=torch.int32)
        classes = torch.searchsorted(known, labels.int(), out_int32=True).to(class_type(len(ids)))
    return PhotoPixels(capture.photos[row], capture.alpha(row), classes, capture.valid(row))


def _resized(pixels: PhotoPixels, size: tuple[int, int]) -> PhotoPixels:
    """The averages of what each pixel covers; of classes the nearest."""
    photo, alpha = (
        None if t is None else cv2.resize(t.numpy(), size, interpolation=cv2.INTER_AREA)
        for t in pixels[:2]
    )
    classes = None if pixels.classes is None else resize_labels(pixels.classes, size[::-1])
    valid = None if pixels.valid is None else shrink_mask(pixels.valid, size[::-1])
    return PhotoPixels(
        torch.from_numpy(photo), None if alpha is None else torch.from_numpy(alpha), classes, valid
    )


def _on(device: torch.device, camera: Cameras, pixels: PhotoPixels) -> TrainingView:
    """The pixels on the device, where they become floats; nothing waits for it."""
    photo, alpha, classes, valid = (
        None if t is None else t.to(device, non_blocking=True) for t in pixels
    )
    assert photo is not None
    alpha = None if alpha is None else alpha[..., None].float().div_(255)
    if device.type == "cuda":
        viewmats, Ks = (
            t.pin_memory().to(device, non_blocking=True) for t in (camera.viewmats, camera.Ks)
        )
        camera = replace(camera, viewmats=viewmats, Ks=Ks)
    return TrainingView(camera, photo.float().div_(255), alpha, classes, valid)


def learned_ids(capture: Capture, rows: Sequence[int]) -> tuple[int, ...]:
    """The label ids of the photos trained on (`rows`), background first; none without label maps.

    Reads all label maps, one at a time. Says in one line which objects are not learned because
    only held-out photos show them.
    """
    if capture.label_maps is None:
        return ()
    found = {row: ids_of(capture.labels(row)) for row in track(range(len(capture)), "reading ids")}
    labelled = [found[row] for row in rows if found[row]]
    trained = {BACKGROUND}.union(*labelled)
    unseen = {row: ids - trained for row, ids in found.items() if ids - trained}
    if unseen:
        names = capture.object_names
        ids = sorted(set().union(*unseen.values()))
        objects = join_names([f"{id} ({names[id]})" if id in names else str(id) for id in ids])
        photos = join_names([capture.cameras.names[row] for row in unseen])
        say(
            f"Only held-out photos show object {objects}, so training does not learn it: {photos}. "
            "Use `--test-every 0` to train on all photos, or another value to hold out others."
        )
    return tuple(sorted(trained)) if labelled else ()


def class_type(count: int) -> torch.dtype:
    """The smallest type that so many classes fit into."""
    if count <= 2**8:
        return torch.uint8
    return torch.int16 if count <= 2**15 else torch.int32
