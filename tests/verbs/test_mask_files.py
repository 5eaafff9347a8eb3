import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.label_maps import write_label_map
from stylesplat.scene.capture import Capture
from stylesplat.verbs.mask import mask

WIDTH, HEIGHT = 12, 8


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three photos with poses and nothing else."""
    frames = []
    for i in range(3):
        name = f"images/{i}.png"
        (tmp_path / "images").mkdir(exist_ok=True)
        Image.fromarray(np.full((HEIGHT, WIDTH, 3), 80 * i, np.uint8)).save(tmp_path / name)
        pose = np.eye(4)
        pose[0, 3] = i
        frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    lens = {"fl_x": 10.0, "fl_y": 10.0, "cx": 6.0, "cy": 4.0, "w": WIDTH, "h": HEIGHT}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return tmp_path


def labels(id: int) -> torch.Tensor:
    """`id` in the left half, background in the right."""
    maps = torch.zeros(HEIGHT, WIDTH, dtype=torch.int64)
    maps[:, : WIDTH // 2] = id
    return maps


def attached(capture: Capture, row: int) -> torch.Tensor:
    assert capture.label_maps is not None
    found = capture.label_maps[row]
    assert found is not None
    return found


def write_maps(folder: Path, ids: dict[str, int]) -> None:
    folder.mkdir()
    for stem, id in ids.items():
        write_label_map(labels(id), folder / f"{stem}.png")


def test_attaches_the_maps_of_the_capture(folder: Path):
    capture = load(folder)
    write_maps(folder / "object_mask", {"0": 1, "2": 70000})
    masked = mask(capture, source=folder / "object_mask")
    assert torch.equal(attached(masked, 0), labels(1).int())
    assert masked.label_maps is not None and masked.label_maps[1] is None
    assert torch.equal(attached(masked, 2), labels(70000).int())
    assert masked.photos is capture.photos


def test_another_folder_wins(folder: Path, tmp_path: Path):
    write_maps(folder / "object_mask", {"0": 1})
    write_maps(tmp_path / "mine", {"0": 5})
    masked = mask(load(folder), source=tmp_path / "mine")
    assert torch.equal(attached(masked, 0), labels(5).int())


@pytest.mark.parametrize("downscale", [2.0, 3.0])
def test_maps_have_the_size_of_the_photos(folder: Path, downscale: float):
    capture = load(folder, downscale=downscale)
    write_maps(folder / "object_mask", {"0": 3})
    masked = mask(capture, source=folder / "object_mask")
    assert torch.equal(attached(masked, 0), attached(load(folder, downscale=downscale), 0))


def test_rows_are_matched_by_name(folder: Path):
    write_maps(folder / "object_mask", {"0": 1, "2": 2})
    capture = load(folder)
    last = replace(
        capture, cameras=capture.cameras[[2]], photos=[capture.photos[2]], label_maps=None
    )
    masked = mask(last, source=folder / "object_mask")
    assert torch.equal(attached(masked, 0), labels(2).int())


def test_nothing_to_go_by(folder: Path):
    with pytest.raises(StyleSplatError, match=r"Nothing says what to mask.*another program"):
        mask(load(folder))


def test_a_folder_that_is_not_there(folder: Path):
    with pytest.raises(StyleSplatError, match="no folder"):
        mask(load(folder), source=folder / "nowhere")


def test_a_capture_from_nowhere(folder: Path):
    write_maps(folder / "object_mask", {"0": 1})
    nowhere = replace(load(folder, downscale=2.0), path=None)
    masked = mask(nowhere, source=folder / "object_mask")
    assert torch.equal(attached(masked, 0), labels(1).int()[::2, ::2])
    write_label_map(labels(1)[:, :5], folder / "object_mask" / "0.png")
    with pytest.raises(StyleSplatError, match=r"label map of 0\.png is 5x8.*shape of its photo"):
        attached(mask(nowhere, source=folder / "object_mask"), 0)
