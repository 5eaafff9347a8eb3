from pathlib import Path

import pytest
import torch

from stylesplat.demo import demo_capture as demo
from stylesplat.demo.demo_capture import demo_capture, write_demo_capture
from stylesplat.demo.still_life import OBJECT_NAMES, dome_cameras, photograph
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.transforms import read_transforms
from stylesplat.io.images import read_image
from stylesplat.io.json_files import read_json
from stylesplat.io.label_maps import read_label_map


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("demo") / "capture"
    return write_demo_capture(path, views=3, width=48, height=36)


def test_what_was_rendered_is_read_back(folder: Path):
    cameras = dome_cameras(3, 48, 36)
    posed = read_transforms(folder)
    assert posed.names == cameras.names
    torch.testing.assert_close(posed.viewmats.float(), cameras.viewmats, atol=1e-5, rtol=0)
    for name, view in zip(cameras.names, photograph(cameras, seed=0), strict=True):
        assert torch.equal(read_image(folder / "images" / name), view.photo)
        exact = read_label_map(folder / "object_mask_exact" / name)
        assert torch.equal(exact.long(), view.labels)
        assert read_label_map(folder / "object_mask" / name).shape == exact.shape


def test_points_names_and_styles_are_there(folder: Path):
    posed = read_transforms(folder)
    assert posed.points is not None and len(posed.points) == demo.POINTS
    names = read_json(folder / "object_names.json")
    assert names == {str(i): name for i, name in OBJECT_NAMES.items()}
    for style in demo.STYLES:
        assert min(read_image(folder / "styles" / f"{style}.png").shape[:2]) >= 512


def test_the_capture_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    made = []

    def make(path: Path, **settings: object) -> Path:
        made.append(settings)
        path.mkdir()
        (path / demo.MARKER).write_text("{}")
        return path

    monkeypatch.setattr(demo, "write_demo_capture", make)
    first = demo_capture(tmp_path, seed=4)
    assert demo_capture(tmp_path, seed=4) == first
    assert demo_capture(tmp_path, seed=5) != first
    assert [m["seed"] for m in made] == [4, 5]


def test_a_folder_with_something_in_it_is_refused(tmp_path: Path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(StyleSplatError, match="something else"):
        write_demo_capture(tmp_path, views=1, width=8, height=6)
