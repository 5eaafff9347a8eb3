"""The page of `benchmarks/looks.py`, and what it paints and is painted on."""

import json
from pathlib import Path

import pytest
from looks import Options, main

import stylesplat as ss
from balls import CAMERAS, ball, enlarged
from balls import STRIPED_SCENE as SCENE
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene


@pytest.mark.usefixtures("quick_painting")
def test_an_object_is_painted_judged_and_shown_once(tmp_path: Path):
    cameras = enlarged(CAMERAS, 4)
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
