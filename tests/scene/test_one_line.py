"""What Python prints of nouns."""

from pathlib import Path

import torch

import stylesplat as ss
from balls import CAMERAS, SPLATS
from scenes import plain_layer
from stylesplat.scene.cache import Lazy
from stylesplat.scene.layer import Source
from stylesplat.scene.scene import SceneObject


def test_what_python_prints():
    count = f"{len(SPLATS):,} Gaussians"
    vase = SceneObject(torch.arange(len(SPLATS)) < 20, {"ids": [3]})
    sources = (Source(Path("styles/wave.jpg")), Source(None))
    layer = plain_layer(SPLATS, torch.arange(20), "vase", canvas=5, strength=0.7, styles=sources)
    scene = ss.Scene(
        SPLATS, CAMERAS, ("0000.jpg",), 1.0, {"vase": vase}, SPLATS, (layer,), Path("garden-wave")
    )
    for noun, expected in (
        (SPLATS, f"Splats({count}, SH degree {SPLATS.sh_degree}, with identities)"),
        (SPLATS.classifier, "Classifier(label ids 0 3 7 300)"),
        (vase, f"SceneObject(20 of {count}, label ids 3)"),
        (layer, "Layer(vase like wave.jpg, a picture, 20 Gaussians, 5 new, strength 0.7, compact)"),
        (ss.Scene(SPLATS, CAMERAS), f"Scene({count}, 8 views)"),
        (
            scene,
            f"Scene({count}, 8 views (1 held out), objects: vase, painted: vase, garden-wave)",
        ),
    ):
        assert repr(noun) == expected


def test_a_capture_reads_no_photos_for_it():
    read = []
    photos = Lazy([lambda: read.append("photo") or torch.zeros(36, 48, 3, dtype=torch.uint8)] * 8)
    capture = ss.Capture(CAMERAS, photos, path=Path("garden"))
    read.clear()  # types were checked
    assert repr(capture) == "Capture(8 photos, 48x36, garden)" and not read
