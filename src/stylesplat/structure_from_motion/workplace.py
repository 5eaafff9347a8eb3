"""The folder in which structure from motion works: its database and what that was made from."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from errno import ENOSPC
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.io.files import cannot_write, inside
from stylesplat.io.json_files import read_json, write_json
from stylesplat.progress import say
from stylesplat.structure_from_motion.long_calls import FATAL, is_full, run_stage
from stylesplat.structure_from_motion.photo_groups import PhotoGroup, group_photos
from stylesplat.structure_from_motion.sfm_config import SfmConfig


@dataclass(frozen=True)
class Workplace:
    """A folder with a database whose photos are numbered, for COLMAP's lists know no blanks."""

    folder: Path
    """All that is written lies in it."""
    names: tuple[str, ...]
    """The photos, as the caller knows them."""
    files: tuple[str, ...]
    """The same, as the database knows them."""
    groups: tuple[PhotoGroup, ...]
    """Which of them share a camera."""
    config: SfmConfig
    """How to work."""

    @property
    def database(self) -> Path:
        """Features and matches."""
        return self.folder / "database.db"

    @property
    def photos(self) -> Path:
        """Copies of the photos."""
        return self.folder / "numbered"

    @property
    def models(self) -> Path:
        """What the mapper writes."""
        return self.folder / "models"

    def run(
        self, stage: str, what: str, total: int, unit: str, *, done: int = 0, **settings: Any
    ) -> None:
        """Run a stage of COLMAP on this database; see `run_stage`."""
        known = {"database": str(self.database), "photos": str(self.photos)}
        threads = torch.get_num_threads()
        also = {"threads": threads, "seed": self.config.seed, "done": done}
        run_stage(stage, known | also | settings, what, total, unit, done)

    @contextmanager
    def opened(self) -> Iterator[pycolmap.Database]:
        """The database, to read from.

        COLMAP brings its own SQLite. Python's would be a second one in this process, and two of
        them undo each other's locks (sqlite.org/howtocorrupt.html, 2.2.1).

        Raises:
            StyleSplatError: If it is damaged, or the disk is full.
        """
        level = pycolmap.logging.minloglevel
        pycolmap.logging.minloglevel = FATAL  # what fails is raised
        try:
            with pycolmap.Database.open(self.database) as database:
                yield database
        except RuntimeError as error:
            if is_full(str(error)):
                raise cannot_write(self.database, OSError(ENOSPC, "")) from error
            raise StyleSplatError(
                f"Cannot read {self.database}: it is damaged. Run the same command again."
            ) from error
        finally:
            pycolmap.logging.minloglevel = level


def open_workplace(
    folder: Path, photos: Path, names: Sequence[str], config: SfmConfig
) -> Workplace:
    """Go on where an earlier call for the same photos and settings ended, or begin anew.

    Raises:
        StyleSplatError: If a photo cannot be read, or the folder not be written to.
    """
    files = tuple(f"{row:06}{Path(name).suffix.lower()}" for row, name in enumerate(names))
    groups = group_photos(photos, names, config.cameras)
    place = Workplace(folder, tuple(names), files, groups, config)
    basis = _basis(photos, names, config)
    if place.database.exists() and _basis_file(place).exists():  # else it is unfinished
        if _goes_on(place, basis):
            return place
        say(f"{place.database} is of other photos or settings, or damaged: features are new.")
    _begin(place, photos, basis)
    return place


def _basis(photos: Path, names: Sequence[str], config: SfmConfig) -> dict[str, Any]:
    """What a database depends on, as JSON has it."""
    states = [(photos / name).stat() for name in names]
    return {
        "photos": [[n, s.st_size, s.st_mtime_ns] for n, s in zip(names, states, strict=True)],
        "max_size": config.max_size,
        "max_features": config.max_features,
        "cameras": config.cameras,
        "seed": config.seed,
        "pycolmap": pycolmap.__version__,
    }


def _goes_on(place: Workplace, basis: dict[str, Any]) -> bool:
    try:
        return (
            read_json(_basis_file(place)) == basis
            and _names_in_whole(place) <= {*place.files}
            and all((place.photos / file).is_file() for file in place.files)
        )
    except StyleSplatError:
        return False


def _names_in_whole(place: Workplace) -> set[str]:
    """The photos in a database of which all can be read."""
    with place.opened() as database:
        images = database.read_all_images()
        for image in images:
            database.read_keypoints(image.image_id)
            database.read_descriptors(image.image_id)
        database.read_all_matches()
        database.read_two_view_geometries()
        return {image.name for image in images}


def _basis_file(place: Workplace) -> Path:
    return place.folder / "database.json"


def _begin(place: Workplace, photos: Path, basis: dict[str, Any]) -> None:
    """Make the database; what it is made from is written last, so that half of it is not used."""
    try:
        for file in (_basis_file(place), *place.folder.glob("database.db*")):
            file.unlink(missing_ok=True)
        with suppress(FileNotFoundError):
            shutil.rmtree(place.photos)
        place.photos.mkdir(parents=True)
        for name, file in zip(place.names, place.files, strict=True):
            shutil.copyfile(inside(photos, name), place.photos / file)
    except OSError as error:
        raise cannot_write(place.folder, error) from error
    groups = [
        {"names": [place.files[row] for row in group.rows], "model": group.model}
        for group in place.groups
    ]
    place.run("import_photos", "Photos", len(place.files), "photo", groups=groups)
    write_json(basis, _basis_file(place))
