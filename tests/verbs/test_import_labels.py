"""Splats whose objects are known from a label per Gaussian."""

from pathlib import Path

import numpy as np
import pytest
import torch

from balls import BALLS, SPLATS
from capture_files import write_ball_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.selection.identities import class_probabilities
from stylesplat.selection.pick import pick
from stylesplat.training.lifting import MANY, labelled
from stylesplat.verbs.import_ import import_
from stylesplat.verbs.load import load
from stylesplat.verbs.objects import objects
from stylesplat.verbs.select import select

LABELS = torch.tensor([0] * 200 + [id for id in BALLS for _ in range(80)])


@pytest.fixture
def file(tmp_path: Path) -> Path:
    np.save(tmp_path / "labels.npy", LABELS.numpy())
    return tmp_path / "labels.npy"


def test_objects_are_what_the_labels_say(file: Path, tmp_path: Path, said: list[str]):
    scene = import_(SPLATS, labels=file, up="z", device="cpu")
    assert scene.metrics["label_ids"] == 3 and scene.metrics["unlabelled_gaussians"] == 200
    scene_folder.save(scene, tmp_path / "scene")
    scene = scene_folder.open(tmp_path / "scene")
    assert [each["id"] for each in objects(scene)] == [*BALLS]
    for id in BALLS:
        picked = pick(scene.splats, object_id=id, threshold=0.9, remove_outliers=False)
        assert torch.equal(picked, torch.eq(LABELS, id))
    scene = select(scene, "table", background=True)
    assert torch.equal(scene.objects["table"].picked, torch.eq(LABELS, 0))
    assert scene.splats.confidence is None, "they were not lifted"
    assert not any("No label maps" in line for line in said)


def test_they_take_the_place_of_label_maps(tmp_path: Path, said: list[str]):
    capture = load(write_ball_capture(tmp_path / "capture"))
    assert capture.label_maps is not None
    scene = import_(SPLATS, capture, labels=2 * LABELS, device="cpu")
    assert [each["id"] for each in objects(scene)] == [6, 14, 600]
    assert scene.metrics["psnr"] > 30 and "miou" not in scene.metrics
    assert not any("No label maps" in line for line in said)


def test_labels_of_another_splat_or_of_nothing(file: Path):
    with pytest.raises(StyleSplatError, match=r"labels\.npy: it has 440 labels, but there are 439"):
        import_(SPLATS[torch.arange(439)], labels=file)
    with pytest.raises(StyleSplatError, match="There are 439 labels for 440 Gaussians"):
        import_(SPLATS, labels=LABELS[1:])
    for bad in (0 * LABELS, -LABELS, LABELS + 2**24):
        with pytest.raises(StyleSplatError, match=r"There are \d objects in labels from "):
            import_(SPLATS, labels=bad)


@pytest.mark.parametrize("count", [2, 17, 700])
def test_every_label_is_told_from_all_others(count: int):
    splats = SPLATS[torch.arange(count) % len(SPLATS)]
    found = labelled(splats, 10 * torch.arange(count))
    assert found.classifier is not None
    assert found.classifier.ids == tuple(range(0, 10 * count, 10))
    assert (class_probabilities(found).diagonal() > 0.98).all()
    with pytest.raises(StyleSplatError, match=r"There are 2,048 objects.* Label 1 to 2,047"):
        labelled(SPLATS[torch.arange(MANY + 1) % len(SPLATS)], torch.arange(MANY + 1))
