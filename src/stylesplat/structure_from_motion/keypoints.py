"""The features of all photos."""

from stylesplat.scene.sampling import evenly
from stylesplat.structure_from_motion.workplace import Workplace

SAMPLE = 3  # photos of a camera that tell how closely its photos have to be looked at


def find_keypoints(place: Workplace) -> None:
    """Find the features of the photos that have none in the database yet.

    Raises:
        StyleSplatError: If the disk is full.
    """
    with place.opened() as database:
        images = database.read_all_images()
        found = {i.name for i in images if database.exists_descriptors(i.image_id)}
    groups = []
    for group in place.groups:
        files = [place.files[row] for row in group.rows]
        if missing := [file for file in files if file not in found]:
            groups.append({"names": missing, "sample": evenly(files, SAMPLE)})
    if groups:
        place.run(
            "find_features",
            "finding features",
            len(place.files),
            "photo",
            done=len(found),
            groups=groups,
            max_size=place.config.max_size,
            max_features=place.config.max_features,
        )


def keypoint_counts(place: Workplace) -> dict[str, int]:
    """By name how many features a photo has; those that COLMAP could not read are missing."""
    names = dict(zip(place.files, place.names, strict=True))
    with place.opened() as database:
        return {
            names[image.name]: database.num_keypoints_for_image(image.image_id)
            for image in database.read_all_images()
            if database.exists_keypoints(image.image_id)
        }
