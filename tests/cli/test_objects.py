"""The verb `objects`."""

import threading
from dataclasses import replace
from pathlib import Path

import pytest

from processes import complaint, result
from stylesplat.io import atomic
from stylesplat.io.images import read_image
from stylesplat.io.scene_folder import open
from stylesplat.selection.pick import pick_objects
from stylesplat.selection.soft_picks import own_shares
from stylesplat.verbs.objects import objects


def test_objects_lists_ids_and_draws_them(scene: Path, capsys):
    listed = result(capsys, "objects", scene)
    counts = {entry["id"]: entry["gaussians"] for entry in listed["objects"]}
    assert set(counts) == {3, 7, 300}
    assert all(76 <= count <= 80 for count in counts.values()), "all but a few outliers"
    assert all(0.8 * each["gaussians"] < each["own"] for each in listed["objects"])
    assert "confidence" not in listed["objects"][0], "these labels were not lifted"
    height, width, _ = read_image(listed["sheet"]).shape
    assert width > 3 * 200 and height > 200


def test_haze_is_not_an_objects_own(scene: Path):
    opened = open(scene)
    splats, before = opened.splats, objects(opened)[0]
    picked = pick_objects(splats, [before["id"]])[before["id"]]
    row = own_shares(splats, picked, opened.cameras).argmax(dim=0, keepdim=True)
    scales = splats.scales.index_fill(0, row, 0.0)
    opacities = splats.opacities.index_fill(0, row, -3.0)
    hazy = replace(splats, scales=scales, opacities=opacities)
    after = objects(replace(opened, splats=hazy))[0]
    assert after["gaussians"] == before["gaussians"] and after["own"] == before["own"] - 1


def test_nothing_is_drawn_into_a_scene_that_is_changed(
    scene: Path, capsys, monkeypatch: pytest.MonkeyPatch
):
    """Who changes it takes unfinished files for those of a process that was killed."""
    monkeypatch.setattr(atomic, "PATIENCE", 0.1)
    holding, done = threading.Event(), threading.Event()

    def change() -> None:
        with atomic.changing(scene):
            holding.set()
            done.wait(60)

    thread = threading.Thread(target=change)
    thread.start()
    holding.wait(60)
    try:
        assert "is at work on it" in complaint(capsys, "objects", scene)
    finally:
        done.set()
        thread.join()
    assert not (scene / "objects.png").exists()
