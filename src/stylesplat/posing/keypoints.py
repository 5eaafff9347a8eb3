"""The features of all photos."""

from stylesplat.posing.workplace import Workplace
from stylesplat.scene.sampling import evenly

SAMPLE = 3  # photos of a camera that tell how closely its photos have to be looked at
WITH_FEATURES = "SELECT name FROM images JOIN descriptors USING (image_id)"
COUNTS = "SELECT name, rows FROM images JOIN keypoints USING (image_id)"


def find_keypoints(place: Workplace) -> None:
    """Find the features of the photos that have none in the database yet.

    Raises:
        StyleSplatError: If the disk is full.
    """
    found = {file for (file,) in place.ask(WITH_FEATURES)}
    for number, group in enumerate(place.groups, start=1):
        files = [place.files[row] for row in group.rows]
        if found.issuperset(files):
            continue
        place.run(
            "find_features",
            "finding features" if len(place.groups) == 1 else f"finding features, camera {number}",
            len(files),
            "photo",
            names=files,
            sample=evenly(files, SAMPLE),
            max_size=place.config.max_size,
            max_features=place.config.max_features,
        )


def keypoint_counts(place: Workplace) -> dict[str, int]:
    """By name how many features a photo has; those that COLMAP could not read are missing."""
    names = dict(zip(place.files, place.names, strict=True))
    return {names[file]: count for file, count in place.ask(COUNTS)}
