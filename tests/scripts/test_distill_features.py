from pathlib import Path

import pytest
import torch

import distill_features as distill
from stylesplat.stylization.features import Convolution, FeatureNetwork, compact_from
from training_pictures import training_pictures

OPTIONS = distill.Options(teacher=Path(), steps=5, batch=1, crop=96)


@pytest.fixture(scope="module")
def pictures() -> torch.Tensor:
    return training_pictures(7, seed=0)  # too few for renders: the tracer compiles for 10 s


@pytest.fixture(scope="module")
def teacher(pictures: torch.Tensor) -> distill.Teacher:
    """VGG19's shape with random filters."""
    generator, inputs, blocks = torch.Generator().manual_seed(0), 3, []
    for widths in ((64,) * 2, (128,) * 2, (256,) * 3):
        convs = []
        for width in widths:
            weight = torch.randn(width, inputs, 3, 3, generator=generator) * (2 / 9 / inputs) ** 0.5
            convs.append(Convolution(weight, torch.zeros(width)))
            inputs = width
        blocks.append(tuple(convs))
    network = FeatureNetwork(tuple(blocks), torch.full((3,), 0.5), torch.full((3,), 0.25))
    return distill.find_teacher(network, batches(pictures))


def batches(pictures: torch.Tensor, seed: int = 1):
    return distill.parts(pictures, OPTIONS, torch.Generator().manual_seed(seed))


@pytest.fixture(autouse=True)
def few_batches(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(distill, "BASIS_BATCHES", 1)
    monkeypatch.setattr(distill, "WARM_UP", 1)


def test_training_brings_the_student_closer(teacher: distill.Teacher, pictures: torch.Tensor):
    params = distill.first_weights(torch.Generator().manual_seed(0))
    batch = teacher.teach(next(batches(pictures, seed=2)))

    def cosine() -> float:
        with torch.no_grad():
            return distill.loss_of(compact_from(distill.as_filters(params), "test"), batch)[1]

    before = cosine()
    generator = torch.Generator().manual_seed(3)
    lessons = distill.lessons(teacher, batches(pictures), generator)
    distill.train(params, lessons, OPTIONS, torch.float32)
    assert cosine() > before + 0.2
