"""The verb `render`."""

from pathlib import Path

import av
import numpy as np
import torch

from balls import CAMERAS
from command_line import complaint, run
from stylesplat.io.captures.photos import read_image
from stylesplat.io.label_maps import read_label_map


def test_render_writes_pictures_and_videos(scene: Path, tmp_path: Path):
    assert run("render", scene, "-o", tmp_path / "all") == 0
    assert len(list((tmp_path / "all").iterdir())) == len(CAMERAS)
    assert read_image(tmp_path / "all" / "0003.png").shape == (36, 48, 3)
    assert run("render", scene, "-o", tmp_path / "test", "--views", "test", "--downscale", 2) == 0
    assert [p.name for p in (tmp_path / "test").iterdir()] == ["0000.png"]
    assert read_image(tmp_path / "test" / "0000.png").shape == (18, 24, 3)
    assert run("render", scene, "-o", tmp_path / "ids", "--what", "labels") == 0
    assert set(np.unique(read_label_map(tmp_path / "ids" / "0000.png"))) == {0, 3, 7, 300}
    for what in ("identities", "depth", "object:7"):
        assert run("render", scene, "-o", tmp_path / what[:5], "--what", what) == 0
    assert run("render", scene, "-o", tmp_path / "orbit.mp4", "--views", "train") == 0
    with av.open(str(tmp_path / "orbit.mp4")) as video:
        assert sum(1 for _ in video.decode(video=0)) == len(CAMERAS) - 1


def test_an_object_has_names_and_an_id(scene: Path, tmp_path: Path, capsys):
    assert run("select", scene, "--name", "ball", "--id", 3) == 0
    for name in ("ball", "3"):
        assert run("render", scene, "-o", tmp_path / name, "--what", f"object:{name}") == 0
    for file in (tmp_path / "ball").iterdir():
        assert torch.equal(read_image(file), read_image(tmp_path / "3" / file.name))
    known = complaint(capsys, "render", scene, "-o", tmp_path / "cat", "--what", "object:cat")
    assert "'cat'" in known and ": ball, 3, 7, 300." in known
