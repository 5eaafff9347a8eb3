from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from capture_files import write_capture
from stylesplat.cli.mask import MaskCommand
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.label_maps import read_label_map, write_label_maps
from stylesplat.scene.capture import Capture
from stylesplat.verbs.mask import mask

WIDTH, HEIGHT = 64, 48


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three photos with poses and nothing else."""
    return write_capture(tmp_path / "capture")


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


def save_binary(mask: torch.Tensor, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(255 * mask.numpy().astype(np.uint8)).save(path)


def test_a_capture_gets_its_label_maps(folder: Path, tmp_path: Path):
    capture = folder
    mask = torch.zeros(48, 64, dtype=torch.bool)
    mask[5:20, 9:30] = True
    save_binary(mask, tmp_path / "masks" / "cup" / "001.png")
    save_binary(mask, tmp_path / "masks" / "cup" / "003.png")
    found = MaskCommand(capture, source=tmp_path / "masks").run().values
    assert (found["photos"], found["of"], found["ids"]) == (2, 3, [1])
    assert torch.equal(read_label_map(capture / "object_mask" / "003.png") == 1, mask)
    with pytest.raises(StyleSplatError, match="--overwrite"):
        MaskCommand(capture, source=tmp_path / "masks").run()
    (capture / "object_mask/001.png").write_bytes(b"damaged")
    again = MaskCommand(capture, source=tmp_path / "masks", overwrite=True).run().values
    assert again["ids"] == found["ids"]
    load(capture)  # they are whole again
    before = (capture / "object_mask/001.png").read_bytes()
    save_binary(torch.ones(40, 9, dtype=torch.bool), tmp_path / "masks" / "cup" / "002.png")
    with pytest.raises(StyleSplatError, match="not the shape of its photo"):
        MaskCommand(capture, source=tmp_path / "masks", overwrite=True).run()
    assert (capture / "object_mask/001.png").read_bytes() == before


OPENCV = ("OPENCV", (60.0, 62.0, 31.0, 25.0, -0.3, 0.05, 0.001, 0.002))


def test_masks_of_photos_as_they_were_taken_are_undistorted_once(tmp_path: Path):
    """Those drawn on the photo by another program; what is written fits the undistorted photo."""
    capture = write_capture(tmp_path / "capture", *OPENCV)
    stripes = torch.arange(64).expand(48, 64) // 8 % 2 == 0
    save_binary(stripes, tmp_path / "masks" / "bars" / "001.png")
    in_memory = mask(load(capture), source=tmp_path / "masks")
    MaskCommand(capture, source=tmp_path / "masks").run()
    made, read = attached(in_memory, 0), attached(load(capture), 0)
    assert made.shape == load(capture).photos[0].shape[:2]
    assert torch.equal(made, read)
    assert made.bool().float().mean() > 0.3
    # Also from a capture that is taken at another size
    half = mask(load(capture, downscale=2.0), source=tmp_path / "masks")
    write_label_maps(half, tmp_path / "again")
    again = attached(load(capture, masks=tmp_path / "again"), 0)
    assert (again != made).float().mean() < 0.1, "borders of stripes of eight pixels"


@pytest.mark.parametrize(
    ("id", "fact"), [(0, "nothing but background"), (7, "one object in every pixel")]
)
def test_masks_that_tell_nothing_apart(folder: Path, tmp_path: Path, id: int, fact: str):
    for row in range(3):
        save_binary(torch.full((HEIGHT, WIDTH), id > 0), tmp_path / "m" / "cup" / f"00{row}.png")
    with pytest.raises(StyleSplatError, match=fact):
        mask(load(folder), source=tmp_path / "m")
