"""One click on a splat without labels: how much of the object does it pick, how soon?

Clicks on the fox and its plaque are judged by outlines drawn by hand, those in the middle of each
object of the demo by its exact label maps. Scenes are those of `looks.py`. Objects of the desk, the
toy and the cape are clicked in the middle and at three heights, each in two views, and judged by
label maps.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch
import tyro
from bench import OUT, calibration_ms, capture, machine, table, trained_scene
from fox_outlines import FOX, PLAQUE, outline_mask
from painted_objects import find_scene, photos_of
from scipy.ndimage import distance_transform_edt

import stylesplat as ss
from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import mask_iou
from stylesplat.options import PickSize
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, Mask, ids_of, resize_labels
from stylesplat.scene.scene import Scene
from stylesplat.selection.surface_cut import pick_clicked

Click = tuple[str, tuple[float, float]]
Outline = tuple[Cameras, Mask]

ANIMAL: list[Click] = [
    ("0001.jpg", (250, 480)), ("0001.jpg", (310, 150)), ("0001.jpg", (480, 395)),
    ("0027.jpg", (300, 350)), ("0054.jpg", (400, 300)), ("0094.jpg", (300, 700)),
    ("0110.jpg", (150, 500)),
]  # fmt: skip
BOARD: list[Click] = [
    ("0001.jpg", (110, 500)), ("0001.jpg", (225, 630)), ("0027.jpg", (470, 560)),
    ("0054.jpg", (100, 500)), ("0054.jpg", (150, 250)), ("0054.jpg", (200, 600)),
    ("0054.jpg", (300, 660)),
]  # fmt: skip
EVERY = 3  # of the demo's views are judged, and of MANY
MANY = 8
HEIGHTS = 0.12, 0.5, 0.9  # of an object in a view, from its top


def places(mask: Mask, heights: Sequence[float]) -> list[tuple[float, float]]:
    """A place in the middle of an object, and one where it is widest at each of some heights."""
    inside = torch.from_numpy(distance_transform_edt(mask.numpy()))
    top, bottom = mask.any(dim=1).nonzero()[:, 0].aminmax()
    rows = [int(inside.amax(dim=1).argmax())]
    rows += [int(top + height * (bottom - top)) for height in heights]
    return [(int(inside[row].argmax()) + 0.5, row + 0.5) for row in rows]


def of_labels(name: str) -> Iterator[list]:
    """Rows of the objects that the label maps of a capture show."""
    photos, scene = capture(name), ss.open(trained_scene(name, downscale=1, gaussians=100_000))
    scene = replace(scene, base=replace(scene.base, identities=None, classifier=None))
    maps = {row: photos.labels(row) for row in range(len(photos))}
    views = [(photos.cameras[row], labels) for row, labels in maps.items() if labels is not None]
    for id in sorted({id for _, labels in views for id in ids_of(labels)} - {BACKGROUND}):
        outlines = [(camera, labels == id) for camera, labels in views if (labels == id).any()]
        outlines.sort(key=lambda view: -int(view[1].sum()))
        judged = outlines if len(outlines) < MANY else outlines[::EVERY]
        for camera, mask in (outlines[0], outlines[len(outlines) // 2]):
            for at in places(mask, HEIGHTS):
                yield judge(scene, f"{name} {id}", (camera.names[0], at), judged, "object")


def middles(scene: Scene) -> list[tuple[Click, list[Outline]]]:
    """A click in the middle of each object in the view that shows most of it, and its outlines."""
    photos, found = photos_of(scene), []
    assert photos is not None, "the demo's capture is gone"
    maps = [photos.labels(photos.cameras.index(name)) for name in scene.cameras.names]
    views = [
        (camera, resize_labels(labels, camera.size[::-1]))
        for camera, labels in zip(scene.cameras, maps, strict=True)
        if labels is not None
    ]
    for id in sorted({id for _, labels in views for id in ids_of(labels)} - {BACKGROUND}):
        camera, labels = max(views, key=lambda view: int((view[1] == id).sum()))
        (middle,) = places(labels == id, [])
        outlines = [(c, each == id) for c, each in views[::EVERY] if (each == id).any()]
        found.append(((camera.names[0], middle), outlines))
    return found


def by_hand(scene: Scene, outlines: dict[str, list[tuple[int, int]]]) -> list[Outline]:
    cameras = [scene.cameras[scene.cameras.index(name)] for name in outlines]
    return [(c, outline_mask(c.names[0], c.size, outlines)) for c in cameras]


def judge(scene: Scene, name: str, click: Click, outlines: list[Outline], size: PickSize) -> list:
    """A row of the table."""
    start, place = time.process_time(), f"{click[0]}:{click[1][0]:g},{click[1][1]:g}"
    camera = scene.cameras[scene.cameras.index(click[0])]
    try:
        picked = pick_clicked(scene.splats, scene.cameras, [(camera, click[1])], size=size)
    except StyleSplatError:
        return [name, size, place, "refused", "", ""]
    spent = time.process_time() - start
    shown = [coverage(scene.splats, camera, picked) > COVERED for camera, _ in outlines]
    ious = [mask_iou(one, mask) for one, (_, mask) in zip(shown, outlines, strict=True)]
    return [name, size, place, f"{sum(ious) / len(ious):.3f}", f"{min(ious):.3f}", f"{spent:.2f}"]


def main(
    scenes: Path = OUT / "test_objects", captures: tuple[str, ...] = ("desk", "toy", "cape")
) -> None:
    """Prints a row for each click; the first of a scene makes its graph.

    Args:
        scenes: Where the scenes of `looks.py` are, or are made.
        captures: Whose splats, trained in 200 seconds, are clicked as well.
    """
    fox, demo, rows = find_scene("fox", scenes), find_scene("demo/scene", scenes), []
    animal, board = by_hand(fox, FOX), by_hand(fox, PLAQUE)
    rows += [judge(fox, "fox", click, animal, "object") for click in ANIMAL]
    rows += [judge(fox, "plaque", click, board, "part") for click in BOARD]
    rows += [judge(demo, "demo", *each, "object") for each in middles(demo)]
    rows += [row for name in captures for row in of_labels(name)]
    print(f"{machine()}, calibration loop {calibration_ms():.0f} ms\n")
    print(table(["object", "size", "click", "mean IoU", "least", "processor seconds"], rows))


if __name__ == "__main__":
    tyro.cli(main)
