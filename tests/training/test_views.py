from dataclasses import replace
from functools import partial
from threading import Thread, current_thread

import cv2
import pytest
import torch

from balls import CAMERAS, enlarged
from fake_cuda import cuda  # noqa: F401  (a fixture)
from stylesplat.scene.capture import Capture, resize_labels
from stylesplat.scene.sequences import GIB, Lazy
from stylesplat.training.views import (
    TrainingViews,
    learned_ids,
    split_views,
)

LARGE = enlarged(CAMERAS, 2)  # 96x72
IDS = (0, 3, 7)
BYTES = 96 * 72 * 6  # of a photo, its alpha, its classes and its mask
CPU = torch.device("cpu")
NOISE = torch.Generator().manual_seed(0)
PHOTOS = [torch.randint(256, (72, 96, 3), generator=NOISE).to(torch.uint8) for _ in range(8)]
ALPHAS = [torch.randint(256, (72, 96), generator=NOISE).to(torch.uint8) for _ in range(8)]
MAPS = [torch.tensor(IDS)[torch.randint(3, (72, 96), generator=NOISE)] for _ in range(8)]
VALID = [torch.rand(72, 96, generator=NOISE) > 0.1 for _ in range(8)]
WHOLE = Capture(LARGE, PHOTOS, MAPS, alphas=ALPHAS, valid_masks=VALID)


def counted_reads(rows: list[int]) -> Capture:
    """A capture whose photos note when they are read."""

    def read(row: int) -> torch.Tensor:
        rows.append(row)
        return PHOTOS[row]

    capture = replace(WHOLE, photos=Lazy([partial(read, row) for row in range(8)]))
    rows.clear()  # types are checked by looking at some
    return capture


def views(capture: Capture, memory: float = 1.0) -> TrainingViews:
    ids = () if capture.label_maps is None else IDS
    return TrainingViews(capture, range(8), ids=ids, device=CPU, max_memory=memory)


def test_every_nth_photo_is_held_out_and_whole_photos_are_what_the_capture_holds():
    assert split_views(WHOLE, 3) == ([1, 2, 4, 5, 7], [0, 3, 6])
    viewmats = WHOLE.cameras.viewmats.clone()
    viewmats[1, :3, 3] = torch.tensor([-500.0, 300, 800])
    moved = replace(WHOLE, cameras=replace(WHOLE.cameras, viewmats=viewmats)).without_outliers()
    assert len(moved) == 7 and split_views(moved, 3) == ([1, 3, 4, 6], [0, 2, 5]), "the same photos"
    camera, photo, alpha, classes, _ = views(WHOLE)(3, 1)
    assert camera.names == LARGE[3].names and camera.size == (96, 72)
    assert torch.equal(photo, PHOTOS[3] / 255)
    assert alpha is not None and torch.equal(alpha[..., 0], ALPHAS[3] / 255)
    assert classes is not None and torch.equal(torch.tensor(IDS)[classes.long()], MAPS[3])


def test_photos_that_the_files_hold_out():
    declared = replace(WHOLE, held_out=frozenset(LARGE.names[2:4]))
    assert split_views(declared, 8) == ([0, 1, 4, 5, 6, 7], [2, 3])
    assert split_views(declared, 4) == ([1, 2, 3, 5, 6, 7], [0, 4])
    assert split_views(declared, 0) == ([*range(8)], [])


def test_a_small_pixel_is_valid_where_all_of_it_is():
    mask = torch.ones(72, 96, dtype=torch.bool)
    mask[10, 21] = False
    masked = replace(WHOLE, valid_masks=[mask, *[None] * 7])
    whole, small = (views(masked)(0, factor).valid for factor in (1, 2))
    assert whole is not None and torch.equal(whole, mask)
    assert small is not None and (~small).nonzero().tolist() == [[5, 10]]
    assert views(masked)(1, 2).valid is None


@pytest.mark.parametrize("memory", [1.0, 0.0])
@pytest.mark.parametrize("factor", [2, 4])
def test_smaller_photos_average_and_smaller_maps_pick(factor: int, memory: float):
    camera, photo, alpha, classes, _ = views(WHOLE, memory)(3, factor)
    size = (96 // factor, 72 // factor)
    assert camera.size == size
    expected = cv2.resize(PHOTOS[3].numpy(), size, interpolation=cv2.INTER_AREA)
    assert torch.equal(photo, torch.from_numpy(expected) / 255)
    assert alpha is not None and classes is not None
    expected = cv2.resize(ALPHAS[3].numpy(), size, interpolation=cv2.INTER_AREA)
    assert torch.equal(alpha[..., 0], torch.from_numpy(expected) / 255)
    assert torch.equal(torch.tensor(IDS)[classes.long()], resize_labels(MAPS[3], size[::-1]))


def test_photos_without_alpha_and_label_map():
    plain = replace(WHOLE, label_maps=None, alphas=None)
    _, _, alpha, classes, _ = views(plain)(0, 2)
    assert alpha is None and classes is None
    some = replace(WHOLE, label_maps=[None, *MAPS[1:]], alphas=[None, *ALPHAS[1:]])
    assert views(some)(0, 2)[2:4] == (None, None)
    assert views(some)(1, 2).classes is not None


@pytest.mark.parametrize("items", [0, 3, 8, 11])
def test_what_fits_is_decoded_once_in_all_sizes_and_memory_changes_no_result(items: int):
    rows: list[int] = []
    load, rich = views(counted_reads(rows), items * BYTES / GIB), views(WHOLE)
    for factor in (4, 2, 1, 2):
        for row in [*range(8)] * 2:
            for mine, theirs in zip(load(row, factor)[1:], rich(row, factor)[1:], strict=True):
                assert mine is not None and theirs is not None and torch.equal(mine, theirs)
    assert rows == [*range(8)] if items == 11 else len(rows) > 8


def test_threads_load_what_is_expected_on_a_gpu(cuda: str):  # noqa: F811
    threads: list[Thread] = []

    def read(row: int) -> torch.Tensor:
        threads.append(current_thread())
        return PHOTOS[row]

    capture = replace(WHOLE, photos=Lazy([partial(read, row) for row in range(8)]))
    threads.clear()  # types are checked by looking at some
    load = TrainingViews(capture, range(8), ids=IDS, device=torch.device(cuda), max_memory=0.0)
    whole = views(WHOLE)
    load.expect(3, 2)
    found, expected = load(3, 2), whole(3, 2)
    assert len(threads) == 1 and threads[0] is not current_thread()
    assert found.photo.is_cuda and found.camera.viewmats.is_cuda
    for mine, theirs in zip(found[1:], expected[1:], strict=True):
        assert mine is not None and theirs is not None
        torch.testing.assert_close(mine.cpu(), theirs)
    for row in range(8):  # more than are waited for, and of another size than is asked for
        load.expect(row, 1)
    for row in range(8):
        torch.testing.assert_close(load(row, 2).photo.cpu(), whole(row, 2).photo)
    load.end()


def labelled(capture: Capture, *maps: list[int] | None) -> Capture:
    """One row of labels per photo, photos without repeated."""
    filled = [*maps, *[None] * (len(capture) - len(maps))]
    tensors = [None if ids is None else torch.tensor([ids]) for ids in filled]
    return replace(capture, label_maps=tensors)


def test_ids_of_trained_photos_background_first(capture: Capture, said: list[str]):
    assert learned_ids(capture, range(9)) == (0, 3, 7)
    for bare in (replace(capture, label_maps=None), labelled(capture)):
        assert learned_ids(bare, range(9)) == ()
    assert said == []
    maps = replace(labelled(capture, [1, 2], [2, 3], [4, 0], [5]), object_names={4: "vase"})
    assert learned_ids(maps, [1, 3]) == (0, 2, 3, 5)
    (line,) = said
    assert "object 1, 4 (vase)" in line and "0.png, 2.png" in line and "--test-every" in line
