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
    groups = [[place.files[row] for row in group.rows] for group in place.groups]
    missing = [files for files in groups if not found.issuperset(files)]
    if missing:
        place.run(
            "find_features",
            "finding features",
            len(place.files),
            "photo",
            done=len(found),
            groups=[{"names": files, "sample": evenly(files, SAMPLE)} for files in missing],
            max_size=place.config.max_size,
            max_features=place.config.max_features,
        )


def keypoint_counts(place: Workplace) -> dict[str, int]:
    """By name how many features a photo has; those that COLMAP could not read are missing."""
    names = dict(zip(place.files, place.names, strict=True))
    return {names[file]: count for file, count in place.ask(COUNTS)}
