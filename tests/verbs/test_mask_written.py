"""`stylesplat mask --box` on the balls: what it leaves in the capture's folder."""

import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from capture_files import (
    BALLS,
    CUP,
    LARGE,
    VASE,
    agreement,
    work_at_half_size,
    write_ball_capture,
)
from stylesplat.cli.mask import PREVIEW, Mask
from stylesplat.io.images import read_image
from stylesplat.io.label_maps import NAMES, read_label_map, read_names, write_label_map
from stylesplat.io.scene_folder import save
from stylesplat.verbs.load import load
from stylesplat.verbs.mask import mask


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    work_at_half_size(monkeypatch)


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ball_capture(tmp_path_factory.mktemp("photos"), LARGE, masks=False)


@pytest.fixture
def capture(photos: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(photos, tmp_path / "capture"))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    save(BALLS, tmp_path / "scene")
    return tmp_path / "scene"


def run_mask(capture: Path, boxes: dict, scene: Path | None = None, **options: Any) -> dict:
    """`stylesplat mask CAPTURE --box NAME=VIEW:x0,y0,x1,y1 ...`."""
    typed = tuple(
        f"{name}={view}:{','.join(map(str, place))}" for name, (view, place) in boxes.items()
    )
    return Mask(capture=capture, box=typed, scene=scene, device="cpu", **options).run()


def test_the_command_writes_label_maps_with_names(capture: Path, scene: Path):
    found = run_mask(capture, {"vase": VASE, "cup": CUP}, scene)
    folder = capture / "object_mask"
    assert found == {
        "masks": folder,
        "preview": folder / PREVIEW,
        "photos": 8,
        "of": 8,
        "ids": [1, 2],
        "names": {1: "vase", 2: "cup"},
    }
    assert read_names(folder) == {1: "vase", 2: "cup"}
    assert read_image(folder / PREVIEW).shape[1] > 4 * LARGE.size[0]
    pictures = {f"000{row}.png" for row in range(8)}
    assert {path.name for path in folder.iterdir()} == pictures | {NAMES, PREVIEW}
    in_memory = mask(load(capture), boxes={"vase": VASE, "cup": CUP}, scene=BALLS, device="cpu")
    maps = load(capture).label_maps
    assert maps is not None and in_memory.label_maps is not None
    for on_disk, made in zip(maps, in_memory.label_maps, strict=True):
        assert on_disk is not None and made is not None and torch.equal(on_disk, made.int())


def test_what_an_earlier_run_said_is_replaced_and_nothing_else(capture: Path, scene: Path):
    folder = capture / "object_mask"
    write_label_map(torch.full((36, 48), 5), folder / "0000.png")
    (folder / "mine.png").touch()
    run_mask(capture, {"vase": VASE, "cup": CUP}, scene, overwrite=True)
    assert min(agreement(load(capture), 1, 3)) > 0.8
    (folder / "0000.png").write_bytes(b"damaged")
    run_mask(capture, {"cup": CUP}, scene, overwrite=True)
    assert read_names(folder) == {1: "cup"}
    assert set(read_label_map(folder / "0000.png").unique().tolist()) == {0, 1}
    ids = torch.zeros(144, 192, dtype=torch.int64)
    ids[50:90, 60:120] = 9
    write_label_map(ids, capture.parent / "masks" / "0000.png")
    Mask(capture=capture, source=capture.parent / "masks", overwrite=True).run()
    assert not (folder / NAMES).exists(), "they have no names"
    assert {path.name for path in folder.iterdir()} == {"0000.png", "mine.png", PREVIEW}
