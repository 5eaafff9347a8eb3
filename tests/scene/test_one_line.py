"""What Python prints of nouns."""

from pathlib import Path

import torch

import stylesplat as ss
from balls import CAMERAS, SPLATS
from scenes import plain_layer
from stylesplat.scene.layers import Source
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.selection import Selection
from stylesplat.scene.sequences import Lazy


def test_nouns_are_one_line_that_says_what_they_are():
    vase = SceneObject(torch.arange(len(SPLATS)) < 20, Selection(ids=(3,)))
    layer = plain_layer(SPLATS, torch.arange(20), "vase", strength=0.7, styles=(Source(None),))
    held_out, objects = CAMERAS.names[:1], {"vase": vase}
    scene = ss.Scene(SPLATS, CAMERAS, held_out, 1.0, objects, (layer,), Path("garden"))
    for noun, facts in (
        (SPLATS, ("440 Gaussians", "SH degree 0", "identities")),
        (SPLATS.classifier, ("0 3 7 300",)),
        (vase, ("20 of 440", "3")),
        (layer, ("vase", "a picture", "20 Gaussians", "0.7", "compact")),
        (scene, ("440 Gaussians", "8 views (1 held out)", "vase", "garden")),
    ):
        line = repr(noun)
        assert line.startswith(f"{type(noun).__name__}(") and line.isprintable()
        assert all(fact in line for fact in facts), line


def test_a_capture_reads_no_photos_for_it():
    read = []
    photos = Lazy([lambda: read.append("photo") or torch.zeros(36, 48, 3, dtype=torch.uint8)] * 8)
    capture = ss.Capture(CAMERAS, photos, path=Path("garden"))
    read.clear()  # types were checked
    assert repr(capture) == "Capture(8 photos, 48x36, garden)" and not read
