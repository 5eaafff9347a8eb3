"""Make the capture that ships with the package: a ray-traced still life and three paintings.

    python -m scripts.still_life.make -o still_life
    python -m scripts.still_life.make --ship

The first writes a folder, the second replaces `src/stylesplat/demo/still_life.zip`. Neither takes
much more than a minute. Numba compiles the ray tracer anew each time.
"""

import argparse
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import torch
from PIL import Image

from stylesplat.io.captures.capture_folder import CAPTURE_EXACT, OBJECT_MASK
from stylesplat.io.label_maps import write_label_map

from .label_faults import corrupt_label_maps
from .nerfstudio import write_transforms
from .paintings import PAINTINGS
from .photos import OBJECT_NAMES, arrange, dome_cameras, photograph, surface_points

ARCHIVE = Path(__file__).parents[2] / "src/stylesplat/demo/still_life.zip"
POINTS = 40_000  # with fewer, training takes half as long again to be as sharp
POINT_VIEWS = 12  # how many views the points are taken from
# Pixels: about what lenses and sensors have. Without it the noise of JPEG costs a trained scene
# 1.1 dB of its held-out PSNR.
LENS_BLUR = 0.44
# Of photos and of paintings: what lets the archive have 3 MB. Colours at half the size would make
# photos worse than a lower quality does.
PHOTO_JPEG: dict[str, Any] = {
    "quality": 81,
    "subsampling": 0,
    "optimize": True,
    "progressive": True,
}
PAINTING_JPEG: dict[str, Any] = PHOTO_JPEG | {"quality": 85}
POINT_STEPS = 256  # of one unit: points are rounded to less than their noise, and compress better
# The tracer has z up. Written is what `sfm` writes and viewers of splats expect: y down, z ahead
Y_DOWN = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
EPOCH = (1980, 1, 1, 0, 0, 0)  # of all files in the archive: the same capture is the same archive
NOTE = f"""A still life, ray-traced by scripts/still_life of StyleSplat.

The label maps in {OBJECT_MASK}/ are wrong on purpose, in the ways in which segmenters are: ragged
borders, lost and merged objects. Training has to live with them. Those in {CAPTURE_EXACT}/ say what
is really there; `stylesplat evaluate` compares with these.
"""


def write_capture(
    folder: Path, *, seed: int = 0, views: int = 48, width: int = 480, height: int = 360
) -> None:
    """Render the still life and write it as a nerfstudio capture.

    Beside `images/` and `transforms.json` with its points, `object_mask/` holds label maps with
    a segmenter's mistakes, `object_mask_exact/` the truth, `object_names.json` what the ids
    mean, and `styles/` three paintings.

    Args:
        folder: The folder to fill.
        seed: Of the arrangement, the label maps' mistakes and the paintings.
        views: How many photos.
        width: Of a photo, in pixels.
        height: Of a photo, in pixels.
    """
    cameras = dome_cameras(views, width, height)
    traced = list(photograph(cameras, arrange(seed)))
    exact = [view.labels for view in traced]
    for part in ("images", "styles"):
        (folder / part).mkdir(parents=True)
    for name, view in zip(cameras.names, traced, strict=True):
        photo = cv2.GaussianBlur(view.photo.numpy(), (0, 0), LENS_BLUR)
        Image.fromarray(photo).save(folder / "images" / name, **PHOTO_JPEG)
    for kind, maps in ((OBJECT_MASK, corrupt_label_maps(exact, seed=seed)), (CAPTURE_EXACT, exact)):
        for name, labels in zip(cameras.names, maps, strict=True):
            write_label_map(labels, (folder / kind / name).with_suffix(".png"))
    for name, paint in PAINTINGS.items():
        Image.fromarray(paint(seed)).save(folder / "styles" / f"{name}.jpg", **PAINTING_JPEG)
    chosen = range(0, views, max(views // POINT_VIEWS, 1))
    points, colors = surface_points(cameras[chosen], [traced[i] for i in chosen], POINTS, seed=seed)
    points = (points * POINT_STEPS).round() / POINT_STEPS @ Y_DOWN.T
    upright = torch.block_diag(Y_DOWN, torch.ones(1, 1))
    cameras = replace(cameras, viewmats=cameras.viewmats @ upright.T)
    write_transforms(cameras, folder, points=points, point_colors=colors)
    (folder / "README.txt").write_text(NOTE, encoding="utf-8")
    (folder / "object_names.json").write_text(json.dumps(OBJECT_NAMES, indent=1) + "\n")


def pack(folder: Path, archive: Path) -> None:
    """Write a folder's files into a zip."""
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as bundle:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            info = zipfile.ZipInfo(path.relative_to(folder).as_posix(), EPOCH)
            bundle.writestr(info, path.read_bytes(), zipfile.ZIP_DEFLATED)


def main() -> None:
    """Write the capture of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="a folder that does not exist")
    parser.add_argument("--ship", action="store_true", help="replace the package's archive")
    parser.add_argument("--seed", type=int, default=0, help="others move and turn the objects")
    options = parser.parse_args()
    if options.output:
        write_capture(options.output, seed=options.seed)
    if options.ship:
        with TemporaryDirectory() as folder:
            write_capture(Path(folder), seed=options.seed)
            pack(Path(folder), ARCHIVE)


if __name__ == "__main__":
    main()
