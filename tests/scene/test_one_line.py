"""What Python prints of nouns."""

from pathlib import Path

import torch

import stylesplat as ss
from balls import CAMERAS, SPLATS
from scenes import plain_layer
from stylesplat.scene.cache import Lazy
from stylesplat.scene.layer import Source
from stylesplat.scene.scene import SceneObject

VASE = torch.arange(len(SPLATS)) < 20


def test_captures_read_no_photos_for_it():
    read = []
    photos = Lazy([lambda: read.append("photo") or torch.zeros(36, 48, 3, dtype=torch.uint8)] * 8)
    maps = Lazy([lambda: read.append("map") or torch.zeros(36, 48, dtype=torch.int64)] * 8)
    plain = ss.Capture(CAMERAS, photos, path=Path("garden"))
    names = {3: "vase", 7: "pot"}
    labelled = ss.Capture(CAMERAS, photos, maps, torch.zeros(1, 3), object_names=names)
    read.clear()  # types were checked
    assert repr(plain) == "Capture(8 photos, 48x36, garden)"
    assert repr(labelled) == "Capture(8 photos, 48x36, label maps of vase, pot, 1 point)"
    assert not read


def test_scenes_and_what_is_in_them():
    count = f"{len(SPLATS):,} Gaussians"
    assert repr(SPLATS) == f"Splats({count}, SH degree {SPLATS.sh_degree}, with identities)"
    assert repr(SPLATS.classifier) == "Classifier(label ids 0 3 7 300)"
    scene = ss.Scene(SPLATS, CAMERAS)
    assert repr(scene) == f"Scene({count}, 8 views)"
    vase = SceneObject(VASE, {"ids": [3]})
    assert repr(vase) == f"SceneObject(20 of {count}, label ids 3)"
    sources = (Source(Path("styles/wave.jpg")), Source(None))
    layer = plain_layer(SPLATS, torch.arange(20), "vase", canvas=5, strength=0.7, styles=sources)
    expected = "vase like wave.jpg, a picture, 20 Gaussians, 5 new, strength 0.7, compact"
    assert repr(layer) == f"Layer({expected})"
    scene = ss.Scene(
        SPLATS, CAMERAS, ("0000.jpg",), 1.0, {"vase": vase}, SPLATS, (layer,), Path("garden-wave")
    )
    expected = "8 views (1 held out), objects: vase, painted: vase, garden-wave"
    assert repr(scene) == f"Scene({count}, {expected})"
