"""The page of `benchmarks/looks.py`, and what it paints and is painted on."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from looks import Options, columns, main
from paintings import DRAWN, find_painting
from traced_objects import SHAPES, Shape, arc, photograph

import stylesplat as ss
from balls import CAMERAS, ball, enlarged
from balls import STRIPED_SCENE as SCENE
from stylesplat.scene.scene import Scene, SceneObject


def cell(painting: str, seed: int, **figures: float) -> dict:
    rest = {"object": "fox", "painting": painting, "quality": "normal", "seed": seed}
    return {**rest, "settings": "", "commit": "", "machine": "", "figures": figures}


def test_the_table_has_what_is_known_and_the_means():
    heads, rows = columns([cell("night", 0, kept=0.5), cell("dots", 0, kept=0.25, s=300.0)])
    assert heads == ["object", "painting", "kept", "s"]
    assert rows == [["fox", "night", "0.5", ""], ["fox", "dots", "0.25", "300"],
                    ["mean", "", "0.375", "300"]]  # fmt: skip
    assert columns([cell("night", 0, s=1.0), cell("night", 1, s=1.0)])[0][2] == "seed"


@pytest.mark.parametrize("name", DRAWN)
def test_drawn_pictures_are_what_they_are_called(name: str, tmp_path: Path):
    picture = cv2.imread(str(find_painting(name, tmp_path)))
    assert picture is not None
    colors, counts = np.unique(picture.reshape(-1, 3), axis=0, return_counts=True)
    assert counts.max() > 0.05 * counts.sum(), "some colour is pure"
    edges = np.abs(np.diff(picture.astype(float), axis=0)).max(axis=-1) > 30
    assert (edges.mean() < 0.02) == (name == "flat")
    assert find_painting(name, tmp_path).is_file() and len(colors) > 2


@pytest.mark.parametrize("shape", SHAPES[:1])
def test_traced_objects_stand_in_the_middle_and_face_the_cameras(shape: Shape):
    cameras = arc().downscale(8)
    front, side = (photograph(shape, cameras[row]) for row in (0, 4))
    for view in (front, side):
        rows, columns = (view.labels == 1).nonzero().float().mean(dim=0) / torch.tensor([75, 65])
        assert 0.3 < rows < 0.7 and 0.4 < columns < 0.6
        assert view.depth[view.labels == 1].mean() == pytest.approx(2.5, abs=0.3)
    assert (front.labels == 1).float().mean() > 0.04
    assert front.photo.float().std() > 30


def test_an_object_is_painted_judged_and_shown_once(tmp_path: Path):
    cameras = enlarged(CAMERAS, 8)
    scene = Scene(SCENE, cameras, held_out=cameras.names[::4])
    scene = scene.with_object("doll", SceneObject(ball(0)))
    ss.save(scene, tmp_path / "scenes" / "doll")
    options = Options(
        tmp_path / "page",
        objects=("doll",),
        paintings=("flat",),
        quality="draft",
        views=2,
        scenes=tmp_path / "scenes",
    )
    main(options)
    (file,) = (tmp_path / "page" / "cells").iterdir()
    made = file.stat().st_mtime_ns
    figures = json.loads(file.read_text())["figures"]
    assert {"kept", "compact full", "compact half", "SSIM", "near ratio", "s"} <= figures.keys()
    main(options)
    assert file.stat().st_mtime_ns == made
    page = (tmp_path / "page" / "index.html").read_text()
    shown = [tmp_path / "page" / part.split('"')[0] for part in page.split('src="')[1:]]
    assert len(shown) == 3 and all(picture.is_file() for picture in shown)
