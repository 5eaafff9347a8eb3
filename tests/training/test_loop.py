import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.training.initialize import first_splats, label_ids, scene_extent, seen_together
from stylesplat.training.loop import fit, train
from stylesplat.training.schedule import gaussian_count, photo_downscale, sh_degree
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import split_views

CONFIG = TrainConfig(steps=60, max_gaussians=400, refine_every=20)


def ring(count: int) -> Cameras:
    """Cameras on a circle of radius 3 that look at the origin."""
    viewmats = torch.eye(4).repeat(count, 1, 1)
    angles = torch.arange(count) * 2 * torch.pi / count
    viewmats[:, 0, 0], viewmats[:, 0, 2] = angles.cos(), -angles.sin()
    viewmats[:, 2, 0], viewmats[:, 2, 2] = angles.sin(), angles.cos()
    viewmats[:, 2, 3] = 3
    K = torch.tensor([[70.0, 0.0, 36.0], [0.0, 70.0, 32.0], [0.0, 0.0, 1.0]])
    names = tuple(f"{i}.png" for i in range(count))
    return Cameras(
        viewmats, K.repeat(count, 1, 1), torch.tensor([[72, 64]]).repeat(count, 1), names
    )


@pytest.fixture(scope="module")
def capture() -> Capture:
    """Photos of two blobs, id 3 on the left and id 7 on the right."""
    truth = random_splats(120, sh_degree=0)
    left = torch.arange(len(truth)) < 60
    truth.means.mul_(0.4)
    truth.means[:, 1] += torch.where(left, -0.6, 0.6)
    truth.sh0[left, :, 0] += 2
    cameras = ring(9)
    ids = torch.where(left, 3.0, 7.0)[:, None]
    photos, maps = [], []
    for row in range(len(cameras)):
        image, alphas, _ = rasterize(truth, cameras[row], features=ids)
        photos.append((image[0, ..., :3].clamp(0, 1) * 255).round().to(torch.uint8))
        label = torch.where(image[0, ..., 3] / alphas[0, ..., 0].clamp(min=0.01) > 5, 7, 3)
        maps.append(torch.where(alphas[0, ..., 0] > 0.5, label, 0))
    colors = (truth.sh0[:, 0] * 70 + 128).clamp(0, 255).to(torch.uint8)
    return Capture(cameras, photos, maps, truth.means, colors)


def error(splats: Splats, capture: Capture, row: int) -> float:
    image = rasterize(splats, capture.cameras[row])[0][0]
    return float((image.clamp(0, 1) - capture.photos[row] / 255).square().mean())


def test_held_out_views_get_better(capture: Capture):
    start = first_splats(
        capture, sh_degree=3, max_gaussians=400, generator=torch.Generator().manual_seed(0)
    )
    trained = train(capture, replace(CONFIG, steps=200), device="cpu")
    _, held_out = split_views(capture, CONFIG.test_every)
    for row in held_out:
        assert error(trained, capture, row) < 0.5 * error(start, capture, row)
    assert len(trained) == 400


def test_identities_learn_the_labels(capture: Capture):
    trained = train(capture, CONFIG, device="cpu", steps=600)
    assert trained.classifier is not None and trained.classifier.ids == (0, 3, 7)
    image = rasterize(trained, capture.cameras[0], features=trained.identities)[0][0, ..., 3:]
    classes = trained.classifier.logits(image).argmax(-1)
    assert capture.label_maps is not None
    truth = capture.label_maps[0]
    assert truth is not None
    predicted = torch.tensor(trained.classifier.ids)[classes]
    assert (predicted == truth).float().mean() > 0.9


def test_same_seed_same_splats(capture: Capture):
    one, other, third = (train(capture, CONFIG, device="cpu", seed=seed) for seed in (1, 1, 2))
    for name, tensor in one.tensors().items():
        assert torch.equal(tensor, other.tensors()[name]), name
    assert not torch.equal(one.means, third.means)


def test_continues_from_a_checkpoint(capture: Capture, tmp_path: Path):
    def stop(state, loss, psnr):
        if state.step == 30:
            signal.raise_signal(signal.SIGINT)

    path = tmp_path / "checkpoint.pt"
    with pytest.raises(KeyboardInterrupt):
        fit(capture, CONFIG, checkpoint=path, on_progress=stop)
    continued = fit(capture, CONFIG, checkpoint=path)
    straight = fit(capture, CONFIG)
    assert continued.step == straight.step == CONFIG.steps
    for name, tensor in straight.params.items():
        assert torch.equal(tensor, continued.params[name]), name


def test_checkpoint_of_another_run_is_refused(capture: Capture, tmp_path: Path):
    path = tmp_path / "checkpoint.pt"
    loop.save_checkpoint(path, fit(capture, replace(CONFIG, steps=1)), CONFIG, torch.zeros(1))
    with pytest.raises(StyleSplatError, match="another steps, seed"):
        fit(capture, replace(CONFIG, steps=9, seed=5), checkpoint=path)
    path.write_bytes(b"nonsense")
    with pytest.raises(StyleSplatError, match="it is not a checkpoint"):
        fit(capture, CONFIG, checkpoint=path)


def test_max_seconds_ends_the_run(capture: Capture):
    state = fit(capture, replace(CONFIG, max_seconds=0.3))
    assert state.step > 0
    assert state.seconds >= 0.3


def test_works_without_label_maps_and_points(capture: Capture):
    bare = replace(capture, label_maps=None, points=None, point_colors=None)
    trained = train(bare, CONFIG, device="cpu", steps=5, max_gaussians=30_000)
    assert trained.identities is None and trained.classifier is None
    assert len(trained) > 1000


def test_photos_without_a_label_map_train_colour_only(capture: Capture):
    assert capture.label_maps is not None
    some = replace(capture, label_maps=[capture.label_maps[0], *[None] * (len(capture) - 1)])
    assert train(some, CONFIG, device="cpu", steps=10).identities is not None


def test_cameras_that_share_no_view_are_refused():
    cameras = ring(4)
    away = replace(cameras, viewmats=cameras.viewmats.clone())
    away.viewmats[:, 2, 3] = -3
    with pytest.raises(StyleSplatError, match="outwards"):
        seen_together(away, 100, torch.Generator().manual_seed(0))


def test_views_are_split_evenly(capture: Capture):
    assert split_views(capture, 4) == ([1, 2, 3, 5, 6, 7], [0, 4, 8])
    assert split_views(capture, 0) == (list(range(9)), [])


def test_label_ids_are_those_that_occur(capture: Capture):
    assert label_ids(capture) == (0, 3, 7)


def test_extent_is_the_radius_of_the_cameras(capture: Capture):
    assert scene_extent(capture.cameras) == pytest.approx(3.3, rel=1e-4)


def test_schedules():
    config = TrainConfig(max_gaussians=1000, growth_end=0.5)
    assert [photo_downscale(p, (480, 360), config) for p in (0.0, 0.2, 0.5)] == [4, 2, 1]
    assert photo_downscale(0.0, (100, 100), config) == 1
    assert [sh_degree(p, config) for p in (0.0, 0.15, 0.99)] == [0, 1, 3]
    assert [gaussian_count(p, 10, config) for p in (0.0, 0.25, 0.5, 1.0)] == [10, 100, 1000, 1000]
    assert gaussian_count(1.0, 2000, config) == 2000


def test_cameras_with_hardly_any_field_of_view_are_refused():
    cameras = ring(4)
    cameras.Ks[:, :2, :2] *= 10_000
    with pytest.raises(StyleSplatError, match="no common space"):
        seen_together(cameras, 100, torch.Generator().manual_seed(0))
