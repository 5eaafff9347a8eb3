import ast
from contextlib import contextmanager
from pathlib import Path

import pytest
from PIL import ExifTags, Image

import stylesplat
from corner_photos import corner, write_photos
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.progress import Silence, observed
from stylesplat.structure_from_motion.keypoints import find_keypoints, keypoint_counts
from stylesplat.structure_from_motion.photo_groups import group_photos
from stylesplat.structure_from_motion.sfm_config import SfmConfig
from stylesplat.structure_from_motion.workplace import open_workplace

FAST = SfmConfig(max_features=500)


class Bars(Silence):
    """Remembers what bars are called and where they end."""

    def __init__(self):
        self.bars: list[tuple[str, float, float]] = []

    @contextmanager
    def task(self, what: str, total: int | float | None, unit: str, done: int | float):
        self.begun, self.done = done, done
        yield self
        self.bars.append((what, self.begun, self.done))

    def advance(self, amount: int | float = 1) -> None:
        self.done += amount


def test_foreign_unfinished_and_damaged_databases(tmp_path: Path, said: list[str], capfd):
    prepared = write_photos(tmp_path / "photos", corner(3))
    place = open_workplace(tmp_path / "work", tmp_path / "photos", prepared.names, FAST)
    with pycolmap.Database.open(place.database) as database:
        image = database.read_image(1)
        image.name = "foreign.jpg"
        database.update_image(image)
    open_workplace(tmp_path / "work", tmp_path / "photos", prepared.names, FAST)
    assert len(said) == 1 and "features are new" in said[0]
    (tmp_path / "work" / "database.json").unlink()  # as after a kill while photos are entered
    open_workplace(tmp_path / "work", tmp_path / "photos", prepared.names, FAST)
    assert len(said) == 1
    place.database.write_bytes(b"no database " * 1000)
    with pytest.raises(StyleSplatError, match=r"Cannot read .*database\.db"):
        keypoint_counts(place)
    assert capfd.readouterr().err == ""  # COLMAP says nothing of its own


def test_no_second_sqlite_is_loaded():
    """COLMAP brings its own; Python's would be another one, and they undo each other's locks."""
    root = Path(stylesplat.__file__).parent
    trees = [ast.parse(path.read_text()) for path in root.rglob("*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    imported = {name.name for n in nodes if isinstance(n, ast.Import) for name in n.names}
    imported |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    assert "pycolmap" in imported and "sqlite3" not in imported


def test_photos_of_several_cameras_have_one_bar(tmp_path: Path):
    pictures = corner(6)
    pictures |= {f"0{i}.jpg": pictures[f"0{i}.jpg"][:200] for i in (1, 3, 5)}
    prepared = write_photos(tmp_path / "photos", pictures)
    place = open_workplace(tmp_path / "work", tmp_path / "photos", prepared.names, FAST)
    with observed(bars := Bars()):
        find_keypoints(place)
        assert len(place.groups) == 2 and min(keypoint_counts(place).values()) > 100
        with pycolmap.Database.open(place.database) as database:
            ids = [image.image_id for image in database.read_all_images()]
            found = {id: (database.read_keypoints(id), database.read_descriptors(id)) for id in ids}
            database.clear_keypoints()
            database.clear_descriptors()
            for id in ids[1:]:
                database.write_keypoints(id, found[id][0])
                database.write_descriptors(id, found[id][1])
        find_keypoints(place)
    assert bars.bars == [("finding features", 0, 6), ("finding features", 5, 6)]


def test_each_size_and_lens_has_a_camera(tmp_path: Path):
    write_photos(tmp_path, corner(3))
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength] = 4.2
    Image.open(tmp_path / "00.jpg").save(tmp_path / "03.jpg", exif=exif)
    Image.open(tmp_path / "00.jpg").resize((160, 120)).save(tmp_path / "04.jpg")
    Image.open(tmp_path / "00.jpg").save(tmp_path / "05.png")
    whole = (tmp_path / "05.png").read_bytes()
    (tmp_path / "05.png").write_bytes(whole[: len(whole) // 2])  # its header is enough
    names = [*(f"0{i}.jpg" for i in range(5)), "05.png"]

    def rows(cameras: str) -> list[tuple[int, ...]]:
        return [group.rows for group in group_photos(tmp_path, names, cameras)]

    assert rows("auto") == [(0, 1, 2, 5), (3,), (4,)]
    assert rows("one") == [(0, 1, 2, 3, 5), (4,)]
    assert rows("several") == [(0,), (1,), (2,), (3,), (4,), (5,)]
