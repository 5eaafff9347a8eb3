"""A reconstruction as a capture: photos without distortion and COLMAP's files."""

from pathlib import Path

import numpy as np
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap import posed_images
from stylesplat.io.captures.colmap_files import check_complete
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.io.captures.lens import Lens, places_in
from stylesplat.io.captures.photos import Photo
from stylesplat.io.files import cannot_write, inside
from stylesplat.io.images import write_image
from stylesplat.structure_from_motion.photo_files import color_profile, map_photos

MIN_TRACK = 3  # photos that see a point: the error of points of two is several times as large


def write_colmap(model: pycolmap.Reconstruction, photos: Path, folder: Path) -> None:
    """Write the photos as pinhole cameras would have taken them, and the model of these.

    Photos go to `images/`, under their names, cameras and points to `sparse/0/`.
    """
    images = posed_images(model)
    lenses = {key: Lens.from_colmap(camera) for key, camera in model.cameras.items()}

    def write(image: pycolmap.Image) -> None:
        lens = lenses[image.camera_id]
        source, target = inside(photos, image.name), inside(folder / "images", image.name)
        photo = Photo(source, upright=True, lens=lens, size=lens.pinhole().size)
        write_image(photo.read_with_alpha(), target, icc_profile=color_profile(source))

    map_photos(write, images, "undistorting photos", threads=torch.get_num_threads())
    sparse = folder / "sparse" / "0"
    try:
        sparse.mkdir(parents=True)
        _pinhole_model(model, images, lenses).write_binary(sparse)
        check_complete(sparse)  # COLMAP does not notice that a disk is full
    except OSError as error:
        raise cannot_write(sparse, error) from error
    except StyleSplatError as error:
        raise StyleSplatError(f"Cannot write {sparse}: disk full. Free some space.") from error


def reliable_points(model: pycolmap.Reconstruction) -> set[int]:
    """Ids of the points that enough photos see; only these are written."""
    return {key for key, point in model.points3D.items() if point.track.length() >= MIN_TRACK}


def _pinhole_model(
    model: pycolmap.Reconstruction, images: list[pycolmap.Image], lenses: dict[int, Lens]
) -> pycolmap.Reconstruction:
    reliable, pinholes = reliable_points(model), pycolmap.Reconstruction(model)
    for key in {*model.points3D.keys()} - reliable:
        pinholes.delete_point3D(key)
    for image in images:
        lens, features = lenses[image.camera_id], pinholes.images[image.image_id].points2D
        distorted = np.array([feature.xy for feature in features]).reshape(-1, 2)
        places = places_in(lens.pinhole(), distorted, lens)
        for feature, place in zip(features, places, strict=True):
            feature.xy = place
    for key, lens in lenses.items():
        camera, pinhole = pinholes.cameras[key], lens.pinhole().camera
        camera.model, camera.params = pinhole.model, pinhole.params.tolist()
        camera.width, camera.height = pinhole.width, pinhole.height
    return pinholes
