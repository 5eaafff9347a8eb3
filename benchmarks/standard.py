"""The rows of docs/standard.md: NeRF's synthetic lego and LLFF's fern, trained, masked and painted.

We could not get the masks of other papers: fern's plant is outlined by hand in one photo, around
the tips of its leaflets. Boxes, lines and clicks are in other photos.

    python benchmarks/standard.py --lego nerf_synthetic/lego --fern nerf_llff_data/fern

The folder of fern holds `poses_bounds.npy` and `images_4` alone; that of lego is complete.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import tyro
from bench import STYLES, machine, table

import stylesplat as ss
from stylesplat.imaging.similarity import mask_iou
from stylesplat.masks.grabcut import Stroke
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.capture import Capture, Mask, resize_labels
from stylesplat.scene.scene import Scene

JUDGED, DRAWN = "image006.png", (1008, 756)  # the photo, and its size

# fmt: off
OUTLINE = [
    (458, 578), (466, 560), (470, 540), (474, 510), (468, 495), (465, 482), (440, 477), (420, 475),
    (400, 472), (380, 468), (365, 478), (350, 490), (338, 512), (322, 532), (309, 552), (299, 567),
    (281, 590), (278, 606), (266, 624), (254, 650), (246, 670), (239, 690), (224, 706), (219, 690),
    (219, 650), (227, 615), (238, 590), (260, 560), (278, 525), (295, 492), (285, 497), (262, 503),
    (240, 515), (215, 522), (200, 531), (186, 533), (165, 560), (140, 574), (136, 568), (137, 540),
    (148, 500), (163, 480), (183, 465), (203, 448), (213, 433), (200, 425), (180, 420), (165, 415),
    (150, 418), (135, 415), (125, 412), (108, 405), (92, 418), (76, 431), (63, 448), (66, 425),
    (83, 405), (93, 393), (88, 380), (85, 360), (85, 338), (93, 324), (105, 311), (125, 304),
    (150, 302), (195, 302), (215, 293), (216, 295), (230, 285), (240, 268), (225, 256), (210, 247),
    (190, 243), (170, 244), (150, 251), (130, 263), (110, 271), (95, 272), (115, 257), (135, 244),
    (148, 238), (133, 230), (150, 224), (165, 217), (185, 211), (200, 207), (210, 194), (235, 182),
    (255, 180), (268, 168), (275, 156), (292, 157), (310, 163), (325, 168), (343, 172), (348, 165),
    (335, 157), (317, 158), (335, 145), (358, 137), (384, 146), (400, 157), (412, 172), (423, 184),
    (424, 172), (415, 150), (404, 128), (402, 117), (410, 111), (420, 110), (440, 122), (452, 135),
    (456, 150), (466, 158), (474, 160), (463, 150), (461, 140), (468, 127), (478, 121), (490, 126),
    (500, 138), (505, 130), (510, 115), (517, 100), (525, 88), (534, 70), (550, 59), (570, 48),
    (590, 41), (604, 35), (600, 41), (586, 49), (576, 60), (566, 70), (560, 80), (564, 95),
    (561, 110), (561, 127), (578, 131), (583, 142), (590, 125), (599, 106), (611, 92), (622, 79),
    (640, 69), (656, 69), (670, 75), (678, 88), (668, 88), (655, 84), (641, 90), (636, 100),
    (626, 120), (626, 135), (617, 150), (612, 168), (620, 164), (639, 135), (659, 117), (680, 109),
    (696, 115), (711, 135), (720, 150), (720, 168), (712, 162), (700, 149), (690, 137), (680, 131),
    (670, 131), (656, 141), (646, 152), (640, 166), (635, 181), (630, 197), (622, 216), (640, 214),
    (660, 211), (680, 204), (696, 201), (704, 208), (720, 214), (740, 212), (770, 207), (800, 205),
    (820, 209), (841, 217), (861, 230), (877, 243), (868, 245), (850, 236), (830, 231), (817, 233),
    (822, 245), (832, 258), (840, 270), (845, 278), (835, 281), (825, 279), (815, 270), (805, 264),
    (795, 259), (785, 251), (778, 240), (765, 238), (750, 236), (740, 241), (730, 251), (715, 259),
    (700, 264), (694, 268), (690, 277), (680, 287), (665, 288), (652, 301), (641, 317), (630, 328),
    (622, 340), (613, 352), (610, 373), (640, 352), (660, 338), (680, 325), (700, 310), (715, 299),
    (740, 290), (760, 291), (777, 299), (785, 304), (800, 311), (830, 319), (850, 325), (870, 337),
    (886, 350), (901, 367), (907, 377), (895, 371), (880, 363), (865, 356), (850, 351), (841, 353),
    (850, 362), (865, 369), (880, 375), (897, 383), (899, 394), (890, 399), (870, 403), (855, 405),
    (840, 406), (838, 415), (820, 415), (812, 405), (800, 400), (795, 405), (804, 412), (820, 429),
    (840, 444), (860, 459), (880, 474), (900, 486), (920, 500), (936, 525), (946, 545), (950, 561),
    (940, 565), (925, 553), (915, 541), (900, 531), (885, 526), (865, 516), (845, 506), (830, 496),
    (810, 481), (800, 471), (785, 466), (770, 463), (750, 459), (735, 463), (715, 456), (690, 451),
    (660, 451), (640, 453), (620, 451), (600, 446), (580, 446), (560, 451), (540, 461), (525, 471),
    (519, 482), (520, 500), (515, 520), (510, 545), (505, 565), (500, 578),
]
GAP = [(118, 340), (140, 336), (150, 345), (135, 358), (120, 374), (113, 372)]
# fmt: on

FIRST, SECOND = "image000.png", "image017.png"
BOXES = {FIRST: (152.0, 60.0, 984.0, 732.0), SECOND: (50.0, 10.0, 960.0, 688.0)}
PLANT = [
    [(525, 560), (530, 490), (530, 400), (550, 200)],
    [(230, 370), (430, 380)],
    [(650, 400), (860, 400)],
]
BESIDE = [
    [(590, 500), (680, 500), (700, 620)],
    [(270, 130), (420, 140)],
    [(190, 590), (300, 590)],
    [(450, 640), (600, 640)],
    [(760, 180), (760, 330)],
    [(240, 170), (370, 170)],
]
CLICKS = {"trunk": (526.0, 520.0), "leaves": (540.0, 340.0)}


def plant(size: tuple[int, int]) -> Mask:
    """The plant in the photo, at this width and height."""
    mask = np.zeros(DRAWN[::-1], np.uint8)
    cv2.fillPoly(mask, [np.array(OUTLINE, np.int32)], 1)
    cv2.fillPoly(mask, [np.array(GAP, np.int32)], 0)
    return resize_labels(torch.from_numpy(mask).int(), size[::-1]) > 0


def train(photos: Capture, name: str, **settings: Any) -> tuple[Scene, list[str]]:
    """A scene, and its row: quality of held-out views, Gaussians, steps and time."""
    scene = ss.train(photos, **settings)
    found = scene.metrics
    quality = [f"{found['psnr']:.2f}", f"{found['ssim']:.3f}"]
    counts = [f"{found[each]:,}" for each in ("gaussians", "steps")]
    return scene, [name, *quality, *counts, f"{found['seconds']:.0f}"]


def masks_of(photos: Capture, splat: Scene) -> Iterator[list[str]]:
    """How right are masks of the plant by boxes, lines and clicks."""
    lines = [Stroke(tuple(each), over_object=True) for each in PLANT]
    lines += [Stroke(tuple(each), over_object=False) for each in BESIDE]
    box = {"boxes": {"plant": (FIRST, BOXES[FIRST])}}
    given: dict[str, dict[str, Any]] = {
        f"a box in {FIRST}": box,
        f"a box in {SECOND}": {"boxes": {"plant": (SECOND, BOXES[SECOND])}},
        f"the first and {len(lines)} lines": box
        | {"strokes": {"plant": [(FIRST, line) for line in lines]}},
    }
    for what, each in given.items():
        labels = ss.mask(photos, scene=splat, **each).labels(photos.cameras.index(JUDGED))
        assert labels is not None
        height, width = labels.shape
        yield [what, f"{mask_iou(labels > 0, plant((width, height))):.3f}"]
    camera = splat.cameras[splat.cameras.index(JUDGED)]
    for what, point in CLICKS.items():
        try:
            picked = ss.select(splat, "plant", point=(FIRST, point)).objects["plant"].mask
            shown = coverage(splat.base, camera, picked) > COVERED
            found = f"{mask_iou(shown, plant(camera.size)):.3f}"
        except ss.StyleSplatError:
            found = "refused"
        yield [f"a click on the {what} in {FIRST}", found]


def paintings_of(scene: Scene) -> Iterator[list[str]]:
    """How consistent paintings of the plant are, how near to their styles, and how like it."""
    measured = ["short_range_rmse", "long_range_rmse", "nnfm_before", "nnfm_after", "content_ssim"]
    for style in ("van_gogh_starry_night_1024", "hassam_south_ledges_1070", "ukiyo_e_raiko_1100"):
        found = ss.evaluate(ss.stylize(scene, {"plant": STYLES / f"{style}.jpg"}))
        unpainted = [f"{found[f'{each}_base']['plant']:.3f}" for each in measured[:2]]
        yield [style, *(f"{found[each]['plant']:.3f}" for each in measured), *unpainted]


def main(lego: Path | None = None, fern: Path | None = None, share: float = 1.0) -> None:
    """Prints a table for each section of the page.

    Args:
        lego: Folder of NeRF's lego; none is not trained.
        fern: Folder of LLFF's fern; none is not trained.
        share: Of the time that the page's rows took, for a first look.
    """
    print(machine())
    rows, quality = [], ["scene", "PSNR", "SSIM", "Gaussians", "steps", "seconds"]
    if lego is not None:
        settings = {"max_seconds": 600 * share, "max_gaussians": 300_000, "background": "white"}
        rows.append(train(ss.load(lego), "lego", **settings)[1])
    if fern is not None:
        photos = ss.load(fern)
        settings = {"max_seconds": 150 * share, "max_gaussians": 150_000}
        scene, row = train(photos, "fern", **settings)
        print(table(["given", f"IoU in {JUDGED}"], [*masks_of(photos, scene)]))
        masked = ss.mask(photos, scene=scene, boxes={"plant": (FIRST, BOXES[FIRST])})
        heads = ["style", "short", "long", "NNFM before", "after", "SSIM", "unpainted", "long"]
        print(table(heads, [*paintings_of(ss.train(masked, **settings))]))
        rows.append(row)
    print(table(quality, rows))


if __name__ == "__main__":
    tyro.cli(main)
