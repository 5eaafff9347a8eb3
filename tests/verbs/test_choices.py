"""What a verb is told and cannot be: one line, whichever verb it is."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

import stylesplat as ss
from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.stylization.style import Recipe, Style, StyledObject
from stylesplat.training.config import TRAIN_PRESETS, TrainConfig

pytestmark = pytest.mark.usefixtures("quick_painting")


def photographed() -> Capture:
    """Renders of the balls as photos."""
    with torch.no_grad():
        images = [rasterize(SPLATS, CAMERAS[row])[0][0] for row in range(len(CAMERAS))]
    photos = [(255 * image.clamp(0, 1)).round().to(torch.uint8) for image in images]
    return Capture(CAMERAS, photos)


@pytest.mark.parametrize("preset", TRAIN_PRESETS)
def test_lifting_refuses_settings_of_identities(preset: str):
    other = not TRAIN_PRESETS[preset].identity_geometry
    settings: dict[str, Any] = {"identity_every": 3, "identity_geometry": other}
    for name, value in settings.items():
        with pytest.raises(StyleSplatError, match=name):
            ss.train(photographed(), preset=preset, segment="lift", steps=1, **{name: value})
    with pytest.raises(StyleSplatError, match=r"object_growth.*segment lift"):
        ss.train(photographed(), TrainConfig(steps=1, identity_every=4, object_growth=3.0))
    every = TRAIN_PRESETS[preset].identity_every
    scene = ss.train(photographed(), preset=preset, segment="lift", steps=1, identity_every=every)
    assert scene.metrics["steps"] == 1, "what the preset says itself is taken"


CALLS = {
    "ss.train(capture, steps=1.5)": "steps 1.5: it must be int",
    "ss.train(capture, steps=True)": "steps True: it must be int",
    "ss.train(capture, means_rate=float('nan'))": "means_rate nan: use 0 to 10",
    "ss.train(capture, config=TrainConfig(), preset='paper')": "preset paper and a config",
    "ss.train(capture, steps=9, max_seconds=9)": "steps 9 and max_seconds 9",
    "ss.train(capture, stepz=3)": "no key 'stepz'. Did you mean 'steps'?",
    "ss.train(capture, preset='best')": "no preset 'best'. Use default, paper",
    "ss.train(capture, segment='lifted')": "no way to segment 'lifted'. Use joint, lift",
    "ss.render(scene, 'tests')": "no set of views 'tests'. Use test, train, all",
    "ss.mask(capture, method='sam9')": "no method 'sam9'. Use files, grabcut, sam",
    "ss.import_(SPLATS, capture, frame='blender')": "no frame 'blender'. Use capture",
    "ss.render(scene, device='gpu')": "no device 'gpu'. Use auto, cpu or cuda",
    "ss.Style(SPLATS.means.new_ones(3, 40, 40)).read()": "[3, 40, 40] torch.float32",
    "ss.Style(SPLATS.means.new_ones(40, 40, 3).int()).read()": "[40, 40, 3] torch.int32",
    "ss.import_(SPLATS, up='w')": "no direction 'w'. Use x, -x",
}


def test_choices_are_named():
    """In a process of its own, as types are not checked there, for users."""
    program = f"""
import stylesplat as ss
from balls import CAMERAS, SPLATS
from stylesplat.training.config import TrainConfig
scene, photos = ss.Scene(SPLATS, CAMERAS), [SPLATS.means.new_zeros(36, 48, 3).byte()] * 8
capture = ss.Capture(CAMERAS, photos)
for call in {[*CALLS]}:
    try:
        eval(call)
    except ss.StyleSplatError as error:
        print(error)
"""
    path = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = done.stdout.splitlines()
    assert len(lines) == len(CALLS)
    for line, expected in zip(lines, CALLS.values(), strict=True):
        assert expected in line


def test_one_file_is_not_the_weights_of_two_networks(tmp_path: Path):
    style = Style(torch.rand(64, 64, 3))
    objects = (
        StyledObject("3", style, features="compact"),
        StyledObject("7", style, features="vgg19"),
    )
    with pytest.raises(StyleSplatError, match=r"has compact and vgg19\. Pass --features"):
        ss.stylize(Scene(SPLATS, CAMERAS), Recipe(objects), weights=tmp_path / "vgg.pth")
