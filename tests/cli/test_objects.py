"""The verb `objects`."""

from pathlib import Path

from command_line import result
from stylesplat.io.captures.photos import read_image


def test_objects_lists_ids_and_draws_them(scene: Path, capsys):
    listed = result(capsys, "objects", scene)
    counts = {entry["id"]: entry["gaussians"] for entry in listed["objects"]}
    assert set(counts) == {3, 7, 300}
    assert all(76 <= count <= 80 for count in counts.values()), "all but a few outliers"
    assert "confidence" not in listed["objects"][0], "these labels were not lifted"
    height, width, _ = read_image(listed["sheet"]).shape
    assert width > 3 * 200 and height > 200
