"""The demo scene on disk: photos, cameras, points, label maps good and bad, style pictures."""

from pathlib import Path

import torch

from stylesplat.demo.cloud import surface_points
from stylesplat.demo.faults import FaultConfig, corrupt_label_maps
from stylesplat.demo.shadows import contact_shadows
from stylesplat.demo.still_life import OBJECT_NAMES, View, dome_cameras, photograph
from stylesplat.demo.style_pictures import burning_tide, swirling_night
from stylesplat.io.atomic import atomic_folder
from stylesplat.io.captures.capture_folder import EXACT, OBJECT_MASK
from stylesplat.io.captures.transforms import write_transforms
from stylesplat.io.images import write_image
from stylesplat.io.json_files import write_json
from stylesplat.io.label_maps import write_label_map
from stylesplat.progress import task
from stylesplat.scene.cameras import Cameras

VERSION = 4  # raise it when the same seed gives another picture
POINTS = 40_000  # with fewer, training takes half as long again to be as sharp
POINT_VIEWS = 12  # how many views the points are taken from
MARKER = "object_names.json"  # tells a folder that was made here
NOTE = f"""A still life made by `stylesplat demo`.

The label maps in {OBJECT_MASK}/ are wrong on purpose, in the ways in which segmenters are: ragged
borders, lost and merged objects. Training has to live with them. Those in {EXACT}/ say what
is really there; `stylesplat evaluate` compares with these.
"""
STYLES = {"swirling_night": swirling_night, "burning_tide": burning_tide}


def demo_capture(cache_dir: Path | str, *, seed: int = 0) -> Path:
    """The demo capture of a seed, made on the first call and found again on later ones.

    Args:
        cache_dir: Where captures are kept.
        seed: Of the arrangement, the label maps' mistakes and the paintings.

    Returns:
        The capture's folder.
    """
    path = Path(cache_dir) / f"still_life_v{VERSION}_seed{seed}"
    if (path / MARKER).is_file():
        return path
    return write_demo_capture(path, seed=seed)


def write_demo_capture(
    path: Path | str,
    *,
    seed: int = 0,
    views: int = 48,
    width: int = 480,
    height: int = 360,
    faults: FaultConfig | None = None,
) -> Path:
    """Render the still life and write it as a nerfstudio capture.

    Beside `images/` and `transforms.json` with its points, `object_mask/` holds label maps with
    a segmenter's mistakes, `object_mask_exact/` the truth, `object_names.json` what the ids
    mean, and `styles/` two paintings.

    Args:
        path: The folder to make, whole or not at all.
        seed: Of the arrangement, the label maps' mistakes and the paintings.
        views: How many photos.
        width: Of a photo, in pixels.
        height: Of a photo, in pixels.
        faults: The label maps' mistakes; by default those of the demo.

    Returns:
        `path`.

    Raises:
        StyleSplatError: If `path` holds something or cannot be written to.
    """
    cameras = dome_cameras(views, width, height)
    with atomic_folder(path, overwrite=False, marker=MARKER) as folder:
        seen = []
        with task("demo photos", views, unit="photo") as bar:
            for view in photograph(cameras, seed):
                seen.append(view)
                bar.advance()
        _write_photos(folder, cameras, seen)
        _write_labels(folder, cameras, seen, faults or FaultConfig(), seed)
        _write_styles(folder, seed)
        chosen = range(0, views, max(views // POINT_VIEWS, 1))
        points, colors = surface_points(
            cameras[chosen], [seen[i] for i in chosen], POINTS, seed=seed
        )
        write_transforms(cameras, folder, points=points, point_colors=colors)
        (folder / "README.txt").write_text(NOTE, encoding="utf-8")
        write_json({str(i): name for i, name in OBJECT_NAMES.items()}, folder / MARKER)
    return Path(path)


def _write_photos(folder: Path, cameras: Cameras, views: list[View]) -> None:
    for name, view in zip(cameras.names, views, strict=True):
        write_image(view.photo, folder / "images" / name)


def _write_labels(
    folder: Path, cameras: Cameras, views: list[View], faults: FaultConfig, seed: int
) -> None:
    exact = [view.labels for view in views]
    shadows = contact_shadows(cameras, views, seed) if faults.shadows else None
    faulty = corrupt_label_maps(exact, shadows=shadows, seed=seed, config=faults)
    kinds = {OBJECT_MASK: faulty, EXACT: exact}
    for kind, maps in kinds.items():
        for name, labels in zip(cameras.names, maps, strict=True):
            write_label_map(labels, folder / kind / name)


def _write_styles(folder: Path, seed: int) -> None:
    for name, make in STYLES.items():
        write_image(torch.from_numpy(make(seed)), folder / "styles" / f"{name}.png")
