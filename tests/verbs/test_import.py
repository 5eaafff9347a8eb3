from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS
from capture_files import write_ball_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.captures.capture_folder import load
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import known_frames
from stylesplat.selection.labels import pick
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.export import export
from stylesplat.verbs.import_ import import_
from stylesplat.verbs.objects import objects
from stylesplat.verbs.select import select

PLAIN = replace(SPLATS, identities=None, classifier=None, shN=SPLATS.shN[:, :0])


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return load(write_ball_capture(tmp_path_factory.mktemp("capture")))


@pytest.fixture
def splat(tmp_path: Path) -> Path:
    export(PLAIN, tmp_path / "splat.ply")
    return tmp_path / "splat.ply"


def test_with_photos_and_label_maps(capture: Capture, splat: Path, tmp_path: Path):
    imported = import_(splat, capture, device="cpu")
    metrics = imported.metrics
    assert metrics["psnr"] > 30
    assert metrics["miou"] > 0.9
    assert metrics["gaussians"] == len(PLAIN)
    scene_folder.save(imported, tmp_path / "scene")
    scene = scene_folder.open(tmp_path / "scene")
    for name in ("means", "quats", "scales", "opacities", "sh0"):
        assert torch.equal(getattr(scene.splats, name), getattr(PLAIN, name))
    assert scene.splats.classifier is not None
    assert scene.splats.classifier.ids == (0, *BALLS)
    torch.testing.assert_close(scene.cameras.viewmats, CAMERAS.viewmats, atol=1e-6, rtol=0)
    assert scene.splats.confidence is not None
    seen = scene.splats.confidence[scene.splats.confidence > 0]
    assert metrics["confidence"] == pytest.approx(float(seen.mean()))
    assert all(0.7 < each["confidence"] <= 1 for each in objects(scene))
    assert select(scene, "red", id=3).objects["red"].mask.sum() > 60
    assert scene.info["splat"] == str(splat) and capture.path == scene.capture
    again = evaluate(scene, capture, device="cpu")
    assert again["psnr"] == pytest.approx(metrics["psnr"])


def test_without_photos(splat: Path, said: list[str]):
    scene = import_(splat, up="z", device="cpu")
    assert scene.metrics.keys() == {"gaussians", "seconds"}
    assert "36 views around the content" in "\n".join(said)
    default, down, sideways = (import_(splat, up=up) for up in (None, "-y", "x"))
    assert torch.equal(default.cameras.viewmats, down.cameras.viewmats)
    assert not torch.equal(default.cameras.viewmats, sideways.cameras.viewmats)
    assert len(scene.cameras) == 36 and scene.capture is None
    scene = select(scene, "red", box3d=(-1.1, -0.4, 0.02, -0.3, 0.4, 0.7))
    assert scene.objects["red"].mask.sum() >= 79  # its ball, to rounding
    with pytest.raises(StyleSplatError, match="no identities"):
        select(scene, "green", id=7)


def test_a_splat_in_nerfstudios_frame(capture: Capture, tmp_path: Path):
    frame = known_frames(CAMERAS)["nerfstudio"]
    assert frame.shift is not None
    there = replace(
        PLAIN,
        means=frame.scale * PLAIN.means @ frame.rotation.T + frame.shift,
        scales=PLAIN.scales + torch.tensor(frame.scale).log(),
    )
    with pytest.raises(StyleSplatError, match=r"frame of another program. Pass --frame nerfstudio"):
        import_(there, capture, device="cpu")
    imported = import_(there, capture, frame="nerfstudio", device="cpu")
    assert imported.metrics["psnr"] > 25
    scene_folder.save(imported, tmp_path / "scene")
    scene = scene_folder.open(tmp_path / "scene")
    assert torch.equal(scene.splats.means, there.means), "the splat stays where it is"
    again = evaluate(scene, capture, device="cpu")
    assert again["psnr"] == pytest.approx(imported.metrics["psnr"])


def test_what_does_not_fit_the_photos_or_changes_nothing(capture: Capture, splat: Path):
    generator = torch.Generator().manual_seed(0)
    strange = replace(PLAIN, means=torch.rand(len(PLAIN), 3, generator=generator) * 9 - 4)
    with pytest.raises(StyleSplatError, match="Give the capture that it was made from"):
        import_(strange, capture, device="cpu")
    with pytest.raises(StyleSplatError, match="needs the capture"):
        import_(splat, frame="nerfstudio")
    with pytest.raises(StyleSplatError, match=r"without photos\. Leave it out"):
        import_(splat, capture, up="z")


# Splats whose objects are known from a label per Gaussian

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
    assert torch.equal(scene.objects["table"].mask, torch.eq(LABELS, 0))
    assert scene.splats.confidence is None, "they were not lifted"
    assert not any("No label maps" in line for line in said)


def test_they_take_the_place_of_label_maps(capture: Capture):
    scene = import_(SPLATS, capture, labels=2 * LABELS, device="cpu")
    assert [each["id"] for each in objects(scene)] == [6, 14, 600]
    assert scene.metrics["psnr"] > 30 and "miou" not in scene.metrics


def test_labels_of_another_splat_or_of_nothing(file: Path):
    with pytest.raises(StyleSplatError, match=r"labels\.npy: it has 440 labels, but there are 439"):
        import_(SPLATS[torch.arange(439)], labels=file)
    with pytest.raises(StyleSplatError, match="There are 439 labels for 440 Gaussians"):
        import_(SPLATS, labels=LABELS[1:])
    for bad in (0 * LABELS, -LABELS, LABELS + 2**24):
        with pytest.raises(StyleSplatError, match=r"There are \d objects in labels from "):
            import_(SPLATS, labels=bad)
