"""Label maps into a capture, and from it into its folder."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import open_capture
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import Photo
from stylesplat.io.files import REPLACING, inside, is_file
from stylesplat.io.folders import claim_directory, refuse_occupied
from stylesplat.io.label_maps import NAMES, DrawnLabels, fit_labels, write_label_map, write_names
from stylesplat.progress import track
from stylesplat.scene.cache import Lazy
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import BACKGROUND, ids_of, resize_labels


def with_drawn_maps(
    capture: Capture, maps: Mapping[str, DrawnLabels], names: Mapping[int, str]
) -> Capture:
    """A capture with label maps that were drawn on its photos as they were taken, at any size.

    Args:
        capture: The photos.
        maps: By photo its label map; others have none.
        names: What objects are called, by id.

    Raises:
        StyleSplatError: If a label map is not of its photo's shape.
    """
    photos = _photos_of(capture)
    makers = [
        fit_labels(maps[name], photos[name]) if name in maps else _none
        for name in capture.cameras.names
    ]
    return replace(capture, label_maps=Lazy(makers), object_names=dict(names))


def refuse_label_maps(capture: Capture, folder: Path, *, overwrite: bool) -> None:
    """Check that label maps may be written, before the work that makes them.

    Args:
        capture: The photos.
        folder: Where to.
        overwrite: Whether label maps that are there may be replaced.

    Raises:
        StyleSplatError: If there are some already, a file is in their place, or photos differ in
            their suffix only, or a name or a link leads out of the folder.
    """
    names = capture.cameras.names
    if len({Path(name).with_suffix("") for name in names}) < len(names):
        raise StyleSplatError(
            f"Some photos in {capture.path} differ in their suffix only, so their label maps would "
            "have one name. Rename them."
        )
    paths = [_map_path(folder, name) for name in names]
    if not overwrite and any(map(is_file, paths)):
        raise StyleSplatError(f"{folder} holds label maps already. Replace them with {REPLACING}.")
    refuse_occupied(folder, marker="", overwrite=overwrite)


def write_label_maps(
    capture: Capture, folder: Path, *, overwrite: bool = False
) -> dict[str, set[int]]:
    """Write the label maps of a capture and what their objects are called, whole or not at all.

    They are written at the size of the photos on disk, undistorted, whatever size the capture is
    taken at; other files in the folder stay.

    Args:
        capture: Photos with label maps.
        folder: Where to; the capture's `object_mask/` is where `load` looks for them.
        overwrite: Whether label maps that are there may be replaced.

    Returns:
        By photo that has a label map the ids of its objects.

    Raises:
        StyleSplatError: If there are no label maps, or they cannot be made or written; see also
            `refuse_label_maps`.
    """
    if capture.label_maps is None:
        raise StyleSplatError("This capture has no label maps to write. `mask` makes some.")
    refuse_label_maps(capture, folder, overwrite=overwrite)
    found, stale = dict[str, set[int]](), list[str]()
    with claim_directory(folder, overwrite=overwrite, marker="", stale=stale) as claimed:
        for row, name in enumerate(track(capture.cameras.names, "label maps", unit="photo")):
            labels = capture.label_maps[row]
            if labels is not None:
                whole = resize_labels(labels, capture.full_cameras[row].size[::-1])
                write_label_map(whole, _map_path(claimed, name))
                found[name] = ids_of(whole) - {BACKGROUND}
        called = {id: capture.object_names[id] for id in _named(capture, found.values())}
        write_names(called, claimed)
        stale += _stale({*capture.cameras.names} - found.keys(), named=bool(called))
    return found


def _map_path(folder: Path, name: str) -> Path:
    return inside(folder, name).with_suffix(".png")


def _none() -> None:
    return None


def _named(capture: Capture, found: Iterable[set[int]]) -> list[int]:
    return sorted(set[int]().union(*found) & capture.object_names.keys())


def _photos_of(capture: Capture) -> dict[str, Photo]:
    """The photos by name, with the lenses that they were taken with."""
    sizes = dict(zip(capture.cameras.names, capture.cameras.sizes.tolist(), strict=True))
    if capture.path is None:
        return {name: _undistorted(capture.cameras[row]) for row, name in enumerate(sizes)}
    files = open_capture(capture.path, masks=False)
    return {
        name: files.photos[files.cameras.index(name)].resized(*size) for name, size in sizes.items()
    }


def _undistorted(camera: Cameras) -> Photo:
    """A photo of which nothing is known but its camera."""
    (K,), (width, height) = camera.Ks.tolist(), camera.size
    lens = Lens("PINHOLE", width, height, (K[0][0], K[1][1], K[0][2], K[1][2]))
    return Photo(Path(camera.names[0]), True, lens, (width, height))


def _stale(photos: Iterable[str], *, named: bool) -> list[str]:
    """Files in which earlier label maps say of photos and names what these do not."""
    return [str(Path(name).with_suffix(".png")) for name in photos] + ([] if named else [NAMES])
