"""From photos to a page with one object painted.

python examples/photos_to_painting.py MyPhotos IMG_0007.jpg:500,300,800,700 wave.jpg painting

The box is around the object in one photo, in its pixels. Photos without camera poses get them
first.
"""

import sys
from pathlib import Path
from typing import Any

import stylesplat as ss

POSED = ("sparse", "transforms.json", "poses_bounds.npy")  # what a folder with poses has


def main(photos: str, box: str, picture: str, output: str, **training: Any) -> None:
    """Write `output`/scene, `output`/painted and `output`/painted.html."""
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    has_poses = any((Path(photos) / name).exists() for name in POSED)
    capture = ss.load(photos) if has_poses else ss.sfm(photos, folder / "capture")
    scene = ss.train(capture, **(training or {"max_seconds": 150}))
    print(scene)

    view, _, edges = box.rpartition(":")
    rectangle = tuple(map(float, edges.split(",")))
    capture = ss.mask(capture, boxes={"object": (view, *rectangle)}, scene=scene)
    scene = ss.labels(scene, capture)  # the masks, on the Gaussians
    scene = ss.select(scene, "object", id=1)
    ss.save(scene, folder / "scene")

    painted = ss.stylize(scene, {"object": picture})
    ss.save(painted, folder / "painted")
    ss.export(painted, folder / "painted.html")
    print(painted)


if __name__ == "__main__":
    main(*sys.argv[1:])
