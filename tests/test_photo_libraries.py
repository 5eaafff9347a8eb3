"""A splat that exists needs none of the libraries of the extra `photos`."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from stylesplat.imaging.morphology import disc

WITHOUT = """
import sys
sys.modules |= dict.fromkeys(("av", "cv2", "pycolmap"))  # an import of them fails

from dataclasses import replace
from pathlib import Path

import torch

import stylesplat as ss
import stylesplat.functional
from balls import CAMERAS, RED, SPLATS, VIEWS, painting_quickly
from stylesplat.cli import main
from stylesplat.figures.sheets import object_sheet
from stylesplat.scene import virtual_cameras
from stylesplat.stylization.config import StyleConfig

virtual_cameras.VIRTUAL_VIEWS = len(VIEWS)
folder = Path(sys.argv[1])
means, quats, scales, opacities, sh = SPLATS.activated()
scene = ss.import_(ss.from_gaussians(means, quats, scales, opacities, sh))
scene = replace(scene, cameras=VIEWS)
scene = ss.select(scene, "half", box3d=(-9, -9, -9, 9, 0, 9))
camera, place = scene.cameras[0], torch.cat([means[RED].mean(dim=0), torch.ones(1)])
x, y, z = camera.Ks[0] @ (camera.viewmats[0] @ place)[:3]
scene = ss.select(scene, "ball", point=(camera.names[0], float(x / z), float(y / z)))
style = ss.Style("material:bronze", rotate=20, config=StyleConfig(steps=4, object_size=48))
with painting_quickly():
    scene = ss.stylize(scene, {"half": style}, device="cpu")
scene = ss.recolor(scene, "ball", hue=40)
for what in ("color", "depth"):
    [(name, picture)] = ss.render(scene, scene.cameras.names[:1], what=what)
object_sheet(SPLATS, CAMERAS)
ss.save(scene, folder / "scene")
for file in ("a.ply", "a.spz", "a.glb", "a.html"):
    ss.export(scene, folder / file)
(folder / "photos").mkdir()
for command in (
    ["objects", folder / "scene"],
    ["render", folder / "scene", "-o", folder / "x.mp4"],
    ["mask", folder / "scene", "--box", "a=view_000:10,10,60,60"],
    ["sfm", folder / "photos", "-o", folder / "capture"],
):
    print(command[0], main([str(word) for word in command]))
"""


def test_a_splat_is_selected_painted_rendered_and_exported_without(tmp_path: Path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, tmp_path],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines() == ["objects 0", "render 1", "mask 1", "sfm 1"], done.stderr
    lines = [line for line in done.stderr.splitlines() if "stylesplat[photos]" in line]
    assert [line.split()[1] for line in lines] == ["PyAV", "OpenCV", "pycolmap"]
    assert {"a.ply", "a.spz", "a.glb", "a.html"} <= {p.name for p in tmp_path.iterdir()}
    assert not (tmp_path / "x.mp4").exists()


@pytest.mark.parametrize("width", [1, 2, 5, 12, 31])
def test_discs_are_those_of_opencv(width: int):
    assert (disc(width) == cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))).all()
