"""A reconstruction as a capture: pinhole photos and COLMAP's files."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path, mark
from stylesplat.io.captures.colmap import check_complete, posed_images
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import Photo
from stylesplat.io.files import cannot_write, inside
from stylesplat.io.images import QUALITY
from stylesplat.progress import track
from stylesplat.structure_from_motion.photo_writing import color_profile

LEAST_TRACK = 3  # photos that see a point: those of two are off several times as much


def write_colmap(model: pycolmap.Reconstruction, photos: Path, folder: Path) -> None:
    """Write the photos as pinhole cameras would have taken them, and the model of these.

    Photos go to `images/`, under their names, cameras and points to `sparse/0/`; of the features
    only those of points are kept.

    Args:
        model: Its images have the names of the photos.
        photos: The folder that these lie in.
        folder: A capture to be.

    Raises:
        StyleSplatError: If a photo cannot be read, or the disk is full.
    """
    images = posed_images(model)
    lenses = {key: Lens.from_colmap(camera) for key, camera in model.cameras.items()}
    jobs = [
        (
            Photo(inside(photos, i.name), upright=True, lens=lens, size=lens.pinhole().size),
            inside(folder / "images", i.name),
        )
        for i in images
        for lens in [lenses[i.camera_id]]
    ]
    pool = ThreadPoolExecutor(max_workers=max(1, torch.get_num_threads()))
    try:
        for _ in track(
            pool.map(_write, jobs), "undistorting photos", unit="photo", total=len(jobs)
        ):
            pass
    finally:
        pool.shutdown(cancel_futures=True)
    _write_model(_pinhole_model(model, images, lenses), folder / "sparse" / "0")


def _write(job: tuple[Photo, Path]) -> None:
    photo, path = job
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        Image.fromarray(photo.read_with_alpha().numpy()).save(
            temporary, quality=QUALITY, subsampling=0, icc_profile=color_profile(photo.path)
        )


def _pinhole_model(
    model: pycolmap.Reconstruction, images: list[pycolmap.Image], lenses: dict[int, Lens]
) -> pycolmap.Reconstruction:
    pinholes = pycolmap.Reconstruction()
    for key in sorted({image.camera_id for image in images}):
        camera = lenses[key].pinhole().camera
        camera.camera_id = key
        pinholes.add_camera_with_trivial_rig(camera)
    firm = firm_points(model)
    rows: dict[tuple[int, int], int] = {}  # a feature's new place in its photo
    for image in images:
        kept = [
            row
            for row, point in enumerate(image.points2D)
            if point.has_point3D() and point.point3D_id in firm
        ]
        rows |= {(image.image_id, old): new for new, old in enumerate(kept)}
        lens = lenses[image.camera_id]
        seen = np.array([image.points2D[row].xy for row in kept]).reshape(-1, 2)
        rays = np.asarray(lens.camera.cam_from_img(seen))
        rays = np.concatenate([rays, np.ones_like(rays[:, :1])], axis=1)  # [P, 3]
        places = np.asarray(lens.pinhole().camera.img_from_cam(rays))
        posed = pycolmap.Image(
            image.name, keypoints=places, camera_id=image.camera_id, image_id=image.image_id
        )
        pinholes.add_image_with_trivial_frame(posed, image.cam_from_world())
    for key, point in sorted(model.points3D.items()):
        if key not in firm:
            continue
        views = [(e.image_id, rows[e.image_id, e.point2D_idx]) for e in point.track.elements]
        elements = [pycolmap.TrackElement(*view) for view in views]
        new = pinholes.add_point3D(point.xyz, pycolmap.Track(elements), point.color)
        pinholes.point3D(new).error = point.error
    return pinholes


def firm_points(model: pycolmap.Reconstruction) -> set[int]:
    """The points that are written."""
    return {key for key, point in model.points3D.items() if point.track.length() >= LEAST_TRACK}


def _write_model(model: pycolmap.Reconstruction, sparse: Path) -> None:
    """Write COLMAP's files, all or none."""
    draft = sparse.parent / f".{sparse.name}.{mark()}"
    try:
        draft.mkdir(parents=True)
        model.write_binary(draft)
        check_complete(draft)  # COLMAP does not notice that a disk is full
        shutil.rmtree(sparse, ignore_errors=True)
        draft.replace(sparse)
    except OSError as error:
        raise cannot_write(sparse, error) from error
    except StyleSplatError as error:
        raise StyleSplatError(f"Cannot write {sparse}: disk full. Free some space.") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
