"""The verb `render`."""

import json
from pathlib import Path

import av
import numpy as np
import torch
from PIL import Image

from balls import CAMERAS
from processes import complaint, result, run
from stylesplat.io.images import read_image
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


def test_one_view_into_one_picture(scene: Path, tmp_path: Path, capsys):
    assert run("render", scene, "-o", tmp_path / "all") == 0
    made = result(capsys, "render", scene, "-o", tmp_path / "a.png", "--view", "0002.png")
    assert made == {"output": str(tmp_path / "a.png"), "views": 1}
    expected = read_image(tmp_path / "all" / "0002.png")
    assert torch.equal(read_image(tmp_path / "a.png"), expected)
    two = ("--view", "0002", "--view", "0001")
    assert run("render", scene, "-o", tmp_path / "two", *two) == 0
    assert sorted(p.name for p in (tmp_path / "two").iterdir()) == ["0001.png", "0002.png"]
    assert "2 views" in complaint(capsys, "render", scene, "-o", tmp_path / "b.png", *two)
    line = complaint(capsys, "render", scene, "-o", tmp_path / "b.png", "--views", "orbit")
    assert line.endswith("180 views. Choose one with --view NAME, or name a folder.")
    line = complaint(capsys, "render", scene, "-o", tmp_path / "b", "--views", "orbit", *two)
    assert "--views and --view each choose the views" in line
    assert "'cat'" in complaint(capsys, "render", scene, "-o", tmp_path / "b", "--view", "cat")
    assert not [*tmp_path.glob("b*")]


def played(path: Path) -> tuple[int, float, tuple[int, int]]:
    """Frames, frames a second, and size of a video."""
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        count = sum(1 for _ in video.decode(video=0))
        return count, float(stream.average_rate or 0), (stream.width, stream.height)


def test_length_rate_and_size_of_a_round_trip(scene: Path, tmp_path: Path, capsys):
    trip = ("render", scene, "-o", tmp_path / "a.mp4", "--seconds", 0.5, "--size", "64x30")
    assert run(*trip, "--views", "orbit", "--fps", 10) == 0
    assert played(tmp_path / "a.mp4") == (5, 10, (64, 30))
    assert "--views orbit" in complaint(capsys, *trip, "--overwrite")
    wrong = complaint(capsys, *trip, "--overwrite", "--views", "orbit", "--size", "64")
    assert "WIDTHxHEIGHT" in wrong
    folder = ("render", scene, "-o", tmp_path / "b", "--views", "orbit")
    assert "Leave --fps out" in complaint(capsys, *folder, "--fps", 3)
    assert "0 and 1000" in complaint(capsys, *folder, "--seconds", -1)


def test_a_round_trip_about_an_object_shows_it_large(scene: Path, tmp_path: Path, capsys):
    about = ("render", scene, "--around", "7", "--seconds", 0.2, "--what", "object:7")
    assert run(*about, "-o", tmp_path / "a") == 0
    files = sorted((tmp_path / "a").iterdir())
    assert len(files) == 6
    for file in files:
        ball = (read_image(file) < 250).any(dim=2)
        rows, columns = ball.any(dim=1).nonzero()[:, 0], ball.any(dim=0).nonzero()[:, 0]
        assert len(rows) > 24, "of 36"
        assert abs(float(rows.float().mean()) - 17.5) < 3
        assert abs(float(columns.float().mean()) - 23.5) < 3
    line = complaint(capsys, *about, "-o", tmp_path / "b", "--view", "0000")
    assert "--view and --around each choose" in line
    assert "'cat'" in complaint(capsys, "render", scene, "-o", tmp_path / "b", "--around", "cat")


def test_a_camera_path(scene: Path, tmp_path: Path, capsys):
    frames = [{"view": "0000"}, {"view": "0002"}]
    content = {"keyframes": frames, "seconds": 1, "fps": 5}
    (tmp_path / "path.json").write_text(json.dumps(content))
    made = ("render", scene, "--path", tmp_path / "path.json")
    assert run(*made, "-o", tmp_path / "a.mp4") == 0
    assert played(tmp_path / "a.mp4") == (5, 5, (48, 36))
    assert run(*made, "-o", tmp_path / "a") == 0
    assert run("render", scene, "-o", tmp_path / "b.png", "--view", "0000") == 0
    first = read_image(min((tmp_path / "a").iterdir()))
    assert (first.float() - read_image(tmp_path / "b.png").float()).abs().max() <= 1
    assert "choose the views" in complaint(capsys, *made, "-o", tmp_path / "c", "--around", "7")
    line = complaint(capsys, *made, "-o", tmp_path / "c", "--views", "orbit")
    assert "--views and --path each choose" in line


def test_an_object_cut_out(scene: Path, tmp_path: Path, capsys):
    alone = ("render", scene, "--view", "0000", "--what", "object:7", "-o")
    assert run(*alone, tmp_path / "cut.png", "--background", "transparent") == 0
    with Image.open(tmp_path / "cut.png") as image:
        cut = torch.from_numpy(np.array(image)).float()
    assert cut.shape == (36, 48, 4)
    assert run(*alone, tmp_path / "blue.png", "--background", "#336699") == 0
    alpha = cut[..., 3:] / 255
    composed = cut[..., :3] * alpha + torch.tensor([0x33, 0x66, 0x99]) * (1 - alpha)
    # Rounded twice: alpha and, weighted by it, the colours
    assert (composed - read_image(tmp_path / "blue.png")).abs().max() <= 1.51
    video = ("render", scene, "--what", "object:7", "-o", tmp_path / "v.mp4")
    assert "no transparency" in complaint(capsys, *video, "--background", "transparent")
    line = complaint(capsys, *alone, tmp_path / "x.png", "--background", "blue-ish")
    assert line.endswith("Use transparent, black, white, or a colour as #rrggbb.")
