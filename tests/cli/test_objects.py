"""The verb `objects`."""

from dataclasses import replace
from pathlib import Path

from processes import result
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
