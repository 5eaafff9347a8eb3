"""The folder in which COLMAP works: its database, and copies of the photos under numbers."""

import hashlib
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from errno import ENOSPC
from functools import cached_property
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import cannot_write, resolve_within
from stylesplat.io.images import open_image, read_image, write_image
from stylesplat.io.json_yaml import read_json, write_json
from stylesplat.photo_libraries import pycolmap
from stylesplat.progress import say
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.structure_from_motion.colmap_process import FATAL, is_disk_full, run_stage
from stylesplat.structure_from_motion.config import SfmConfig
from stylesplat.structure_from_motion.photos import group_by_camera, lens_exif

# Photos of one camera that OPENCV's two focal lengths and four distortion coefficients need; with
# fewer, one of each is found. On desk, whose pixels are not square, OPENCV is three times as exact.
# Photos of one object alone do not tell its distortion: the test's turntable fell to pieces
MIN_FOR_OPENCV = 10
UNMASKED = 4  # times more features are found where most are ignored: an object fills a quarter
# Photos of a camera that decide at which size features of its photos are found
WORKSPACE_SAMPLE = 3


@dataclass(frozen=True)
class Workspace:
    """A folder with a database. Its photos are numbered, since COLMAP's lists allow no blanks."""

    folder: Path
    names: tuple[str, ...]
    """The photos, as the caller names them."""
    files: tuple[str, ...]
    """The same, as the database names them."""
    groups: list[list[int]]
    """Rows of photos by camera."""
    config: SfmConfig
    simple_lens: bool = False
    """Whether a lens has one focal length and one coefficient, whatever the number of photos."""
    masks: Path | None = None
    """The folder of black and white pictures, by `mask_file`, of which features are taken."""

    @property
    def database(self) -> Path:
        return self.folder / "database.db"

    @property
    def photos(self) -> Path:
        return self.folder / "numbered"

    @property
    def basis(self) -> Path:
        return self.folder / "database.json"

    @cached_property
    def name_of(self) -> dict[str, str]:
        return dict(zip(self.files, self.names, strict=True))

    def run(
        self, stage: str, what: str, total: int, unit: str, *, done: int = 0, **settings: Any
    ) -> None:
        """Run a stage of COLMAP on this database; see `run_stage`."""
        settings |= {"database": str(self.database), "photos": str(self.photos)}
        settings |= {"threads": torch.get_num_threads(), "seed": self.config.seed}
        run_stage(stage, settings, what, total, unit, done)

    @contextmanager
    def open_database(self) -> Iterator[pycolmap.Database]:
        """The database.

        COLMAP brings its own SQLite. Python's would be a second one in this process, and two of
        them undo each other's locks (sqlite.org/howtocorrupt.html, 2.2.1).
        """
        level = pycolmap.logging.minloglevel
        pycolmap.logging.minloglevel = FATAL
        try:
            with pycolmap.Database.open(self.database) as database:
                yield database
        except RuntimeError as error:
            if is_disk_full(str(error)):
                raise cannot_write(self.database, OSError(ENOSPC, "")) from error
            raise StyleSplatError(
                f"Cannot read {self.database}: it is damaged. Run the same command again."
            ) from error
        finally:
            pycolmap.logging.minloglevel = level


def open_workspace(
    folder: Path,
    photos: Path,
    names: Sequence[str],
    config: SfmConfig,
    masks: Path | None = None,
    *,
    simple_lens: bool = False,
) -> Workspace:
    """Continue an earlier call for the same photos and settings, or start a new database."""
    files = numbered_files(names)
    groups = group_by_camera(photos, names, config.cameras)
    simple_lens |= masks is not None
    workspace = Workspace(folder, tuple(names), files, groups, config, simple_lens, masks)
    stats = [(photos / name).stat() for name in names]
    basis = {
        "photos": [[n, s.st_size, s.st_mtime_ns] for n, s in zip(names, stats, strict=True)],
        "max_size": config.max_size,
        "max_features": config.max_features,
        "cameras": config.cameras,
        "seed": config.seed,
        "pycolmap": pycolmap.__version__,
        "simple_lens": simple_lens,
        "masks": None if masks is None else _digest([masks / mask_file(file) for file in files]),
    }
    if workspace.database.exists() and workspace.basis.exists():  # else it is unfinished
        if _is_usable(workspace, basis):
            return workspace
        say(f"{workspace.database} is of other photos or settings, or damaged: features are new.")
    _create_database(workspace, photos)
    write_json(basis, workspace.basis)  # last, so that half a database is not used
    return workspace


def numbered_files(names: Sequence[str]) -> tuple[str, ...]:
    """The names of photos in a database."""
    return tuple(f"{row:06}{Path(name).suffix.lower()}" for row, name in enumerate(names))


def mask_file(file: str) -> str:
    """The name that COLMAP expects of the mask of a photo."""
    return f"{file}.png"


def _digest(paths: Sequence[Path]) -> str:
    state = hashlib.sha256()
    for path in paths:
        state.update(path.read_bytes())
    return state.hexdigest()


def _is_usable(workspace: Workspace, basis: dict[str, Any]) -> bool:
    """Whether a database is complete, readable and was made from these photos and settings."""
    try:
        if read_json(workspace.basis) != basis:
            return False
        with workspace.open_database() as database:
            images = database.read_all_images()
            for image in images:
                database.read_keypoints(image.image_id)
                database.read_descriptors(image.image_id)
            database.read_all_matches()
            database.read_two_view_geometries()
    except StyleSplatError:
        return False
    known = {image.name for image in images} <= {*workspace.files}
    return known and all((workspace.photos / file).is_file() for file in workspace.files)


def _create_database(workspace: Workspace, photos: Path) -> None:
    try:
        for file in (workspace.basis, *workspace.folder.glob("database.db*")):
            file.unlink(missing_ok=True)
        if workspace.photos.exists():
            shutil.rmtree(workspace.photos)
        workspace.photos.mkdir(parents=True)
        for file, name in workspace.name_of.items():
            _copy_opaque(resolve_within(photos, name), workspace.photos / file)
    except OSError as error:
        raise cannot_write(workspace.folder, error) from error
    groups = list[dict[str, Any]]()
    for rows in workspace.groups:
        is_simple = workspace.simple_lens or len(rows) < MIN_FOR_OPENCV
        model = "SIMPLE_RADIAL" if is_simple else "OPENCV"
        groups.append({"names": [workspace.files[row] for row in rows], "model": model})
    workspace.run("import_photos", "reading photos", len(workspace.files), "photo", groups=groups)


def _copy_opaque(photo: Path, target: Path) -> None:
    """Copy a photo; a cut-out over white, since COLMAP finds little in pictures with alpha."""
    with open_image(photo) as image:
        is_opaque = not image.has_transparency_data
    if is_opaque:
        shutil.copyfile(photo, target)
    else:
        write_image(read_image(photo), target, exif=lens_exif(photo))


def extract_features(workspace: Workspace, *, finest: bool = False) -> None:
    """Extract the features of the photos that have none in the database yet.

    The finest are found at twice the photos' size, in four times as long; else that is done only
    where there are few without.
    """
    with workspace.open_database() as database:
        images = database.read_all_images()
        done = {i.name for i in images if database.exists_descriptors(i.image_id)}
    groups = []
    for rows in workspace.groups:
        files = [workspace.files[row] for row in rows]
        if missing := [file for file in files if file not in done]:
            groups.append({"names": missing, "sample": evenly_spaced(files, WORKSPACE_SAMPLE)})
    if groups:
        workspace.run(
            "extract_features",
            "finding features",
            len(workspace.files),
            "photo",
            done=len(done),
            groups=groups,
            finest=finest,
            max_size=workspace.config.max_size,
            max_features=workspace.config.max_features
            * (1 if workspace.masks is None else UNMASKED),
            masks=None if workspace.masks is None else str(workspace.masks),
        )


def use_simple_lenses(workspace: Workspace) -> bool:
    """Give cameras one focal length and one coefficient; whether any had more.

    What little of its lens a capture tells may lead astray: of 68 photos of a tankard, from three
    widths away before white, 13 fitted together with OPENCV's lens, all with a simple one.
    """
    simple = pycolmap.CameraModelId.SIMPLE_RADIAL
    with workspace.open_database() as database:
        found = [each for each in database.read_all_cameras() if each.model != simple]
        for camera in found:
            focal = camera.mean_focal_length()
            x, y = camera.principal_point_x, camera.principal_point_y
            camera.model, camera.params = simple, [focal, x, y, 0.0]
            database.update_camera(camera)
    return bool(found)


def feature_counts(workspace: Workspace) -> dict[str, int]:
    """How many features each photo has, by name; photos that COLMAP could not read are missing."""
    with workspace.open_database() as database:
        return {
            workspace.name_of[image.name]: database.num_keypoints_for_image(image.image_id)
            for image in database.read_all_images()
            if database.exists_keypoints(image.image_id)
        }
