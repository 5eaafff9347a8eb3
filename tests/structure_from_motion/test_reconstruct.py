import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageCms

import stylesplat
from corner_photos import (
    corner,
    photograph_corner,
    places_around,
    towards,
    turned,
    write_photos,
)
from small_files import no_room
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.progress import Silence, observed
from stylesplat.structure_from_motion.likeness import alike
from stylesplat.structure_from_motion.match_table import MatchTable
from stylesplat.structure_from_motion.pairs import most_alike
from stylesplat.structure_from_motion.reconstruct import Reconstruction, reconstruct
from stylesplat.structure_from_motion.sfm_config import SfmConfig
from stylesplat.structure_from_motion.undistort import write_colmap
from stylesplat.structure_from_motion.unregistered import why_unregistered
from stylesplat.structure_from_motion.workplace import open_workplace

COUNT = 10
FAST = SfmConfig(max_features=500)
BLANK, OTHER, BLURRED = "Ecke/leer.png", "anderswo.jpg", "bewegt.jpg"
MATS = towards(places_around(COUNT))


class Recorder(Silence):
    """Remembers which work is announced; raises in the middle of some, if told to."""

    def __init__(self, interrupted: str = ""):
        self.tasks: list[str] = []
        self.interrupted = interrupted

    @contextmanager
    def task(self, what: str, total: int | float | None, unit: str, done: int | float):
        self.tasks.append(what)
        yield self

    def advance(self, amount: int | float = 1) -> None:
        if self.tasks[-1] == self.interrupted:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("Fotos vom Flur") / "photos"


@pytest.fixture(scope="module")
def work(photos: Path) -> Path:
    return photos.with_name("work")


@pytest.fixture(scope="module")
def prepared(photos: Path):
    pictures = corner(COUNT, prefix="Ecke im Café/Blick ")
    pictures[BLANK] = np.full((240, 320), 90, np.uint8)
    pictures[OTHER] = photograph_corner(MATS[3], seed=9)
    pictures[BLURRED] = photograph_corner(MATS[5], seed=8)
    return write_photos(photos, pictures, sharpness={BLURRED: 0.2})


@pytest.fixture(scope="module")
def result(photos: Path, work: Path, prepared) -> Reconstruction:
    with observed(Recorder("matching photos")), pytest.raises(KeyboardInterrupt):
        reconstruct(photos, prepared, work, config=FAST)
    again = Recorder()
    with observed(again):
        result = reconstruct(photos, prepared, work, config=FAST)
    assert again.tasks == ["matching photos", "finding poses"]  # the features were kept
    return result


def poses(model, names) -> np.ndarray:
    found = {image.name: image for image in model.images.values() if image.has_pose}
    return np.stack([found[name].cam_from_world().matrix() for name in names])


def test_all_photos_of_one_place_are_posed_as_they_were_taken(result: Reconstruction, prepared):
    mats = poses(result.model, prepared.names[:COUNT])
    centres = -np.einsum("cji,cj->ci", mats[:, :, :3], mats[:, :, 3])
    truth = -np.einsum("cji,cj->ci", MATS[:, :3, :3], MATS[:, :3, 3])
    a, b = centres - centres.mean(0), truth - truth.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation, scale = u @ sign @ vt, (s * np.diag(sign)).sum() / (a**2).sum()
    # Photos of 320 pixels whose features are exact to a tenth of one: 0.02 degrees, a few together
    assert np.linalg.norm(scale * a @ rotation.T - b, axis=1).max() < 0.02
    errors = np.einsum("cij,kj,clk->cil", mats[:, :, :3], rotation, MATS[:, :3, :3])
    cosines = (np.trace(errors, axis1=1, axis2=2) - 1) / 2
    assert np.degrees(np.arccos(cosines.clip(-1, 1))).max() < 0.5
    assert result.numbers["registered"] == COUNT and result.numbers["models"] == 1
    assert result.numbers["reprojection_error"] < 1


def test_photos_without_a_pose_are_told_apart(result: Reconstruction):
    reasons = result.unregistered
    assert set(reasons) == {BLANK, OTHER, BLURRED}
    assert reasons[BLANK] == "too little texture: 0 features"
    assert reasons[OTHER] == "too far from the others: it matches none of them"
    assert reasons[BLURRED] == "blurred: 20% as sharp as its neighbours"


@pytest.mark.parametrize(
    ("shared", "reason"),
    [(12, "shares more than 12 features with it, 30 are needed"), (852, "no camera position fits")],
)
def test_shared_features_without_a_pose(shared: int, reason: str, result: Reconstruction, prepared):
    """More of them than a pose needs are no reason, so that something else is."""
    posed = prepared.names[0]
    matches = {("new.jpg", posed): shared, (posed, "new.jpg"): shared}
    reasons = why_unregistered(
        [result.model], {"new.jpg": 1000}, {}, MatchTable(COUNT, matches, 0), [posed, "new.jpg"]
    )
    assert reasons.keys() == {"new.jpg"} and reason in reasons["new.jpg"]


def test_the_capture_is_one_of_pinhole_photos(result: Reconstruction, photos: Path, tmp_path: Path):
    write_colmap(result.model, photos, tmp_path)
    capture = stylesplat.load(tmp_path)
    assert len(capture) == COUNT and capture.points is not None and len(capture.points) > 200
    assert len(capture.points) == result.numbers["points"]
    assert capture.cameras.names[0] == "Ecke im Café/Blick 00.jpg"
    assert capture.photos[0].shape[1] > 300
    assert {p.name for p in (tmp_path / "sparse").iterdir()} == {"0"}
    # Points lie on the features that they were made from
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    before = model.compute_mean_reprojection_error()
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() == pytest.approx(before, rel=0.02)


def test_the_capture_keeps_the_profile_of_colours(result, photos: Path, tmp_path: Path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for image in result.model.images.values():
        path = tmp_path / "photos" / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.open(photos / image.name).save(path, icc_profile=profile)
    write_colmap(result.model, tmp_path / "photos", tmp_path)
    with Image.open(tmp_path / "images" / "Ecke im Café" / "Blick 00.jpg") as image:
        assert image.info["icc_profile"] == profile


def test_the_same_call_gives_the_same_poses_and_finds_nothing_again(
    result: Reconstruction, photos: Path, work: Path, prepared
):
    again = Recorder()
    with observed(again):
        repeated = reconstruct(photos, prepared, work, config=FAST)
    assert again.tasks == ["finding poses"]
    one, other = (poses(r.model, prepared.names[:COUNT]) for r in (result, repeated))
    np.testing.assert_allclose(one, other, atol=1e-6)  # threads add in any order


def test_other_settings_and_a_damaged_database_begin_anew(
    photos: Path, tmp_path: Path, said: list[str]
):
    prepared = write_photos(tmp_path / "photos", corner(3))
    reconstruct(tmp_path / "photos", prepared, tmp_path / "work", config=FAST)
    assert not said
    changed = SfmConfig(max_features=400)
    reconstruct(tmp_path / "photos", prepared, tmp_path / "work", config=changed)
    assert "other photos or settings" in said[0]
    database = tmp_path / "work" / "database.db"
    database.write_bytes(database.read_bytes()[:30000])
    reconstruct(tmp_path / "photos", prepared, tmp_path / "work", config=changed)
    assert len(said) == 2


def test_two_photos_are_too_few(tmp_path: Path):
    prepared = write_photos(tmp_path / "photos", corner(2))
    with pytest.raises(StyleSplatError, match="at least 3 photos, there are 2"):
        reconstruct(tmp_path / "photos", prepared, tmp_path / "work", config=FAST)


def test_photos_without_texture(tmp_path: Path):
    blank = {f"{i}.png": np.full((240, 320), 60 * i, np.uint8) for i in range(4)}
    with pytest.raises(StyleSplatError, match="too little to see in the photos: 0 features"):
        reconstruct(tmp_path, write_photos(tmp_path, blank), tmp_path / "work", config=FAST)


def test_photos_that_do_not_overlap(tmp_path: Path):
    pictures = {f"{i}.jpg": photograph_corner(MATS[i], seed=i) for i in range(4)}
    with pytest.raises(StyleSplatError, match="do not overlap: 0 of 6 pairs match"):
        reconstruct(tmp_path, write_photos(tmp_path, pictures), tmp_path / "work", config=FAST)


def test_photos_of_two_places(tmp_path: Path):
    pictures = corner(4, prefix="a") | corner(4, prefix="b", seed=1)
    with pytest.raises(StyleSplatError, match="different places: they fall into groups of 4, 4"):
        reconstruct(tmp_path, write_photos(tmp_path, pictures), tmp_path / "work", config=FAST)


def test_a_few_photos_of_many_are_no_scene(tmp_path: Path):
    pictures = corner(3) | {f"b{i}.jpg": photograph_corner(MATS[i], seed=i + 1) for i in range(7)}
    with pytest.raises(StyleSplatError, match=r"Only 3 of 10 photos fit together: \d of 45 pairs"):
        reconstruct(tmp_path, write_photos(tmp_path, pictures), tmp_path / "work", config=FAST)


def test_a_panorama(tmp_path: Path):
    pictures = {f"{i}.jpg": photograph_corner(m) for i, m in enumerate(turned(7))}
    with pytest.raises(StyleSplatError, match=r"taken from one place.*Walk around"):
        reconstruct(tmp_path, write_photos(tmp_path, pictures), tmp_path / "work", config=FAST)


def test_a_full_disk_is_called_so_and_the_next_call_goes_on(tmp_path: Path):
    prepared = write_photos(tmp_path / "photos", corner(4))
    with no_room(200_000), pytest.raises(StyleSplatError, match=r"Cannot write .*: disk full"):
        reconstruct(tmp_path / "photos", prepared, tmp_path / "work", config=FAST)
    result = reconstruct(tmp_path / "photos", prepared, tmp_path / "work", config=FAST)
    assert result.numbers["registered"] == 4


KILLED = """
import os, signal, sys
from pathlib import Path
import stylesplat
from stylesplat.progress import Silence, listen
from stylesplat.structure_from_motion.prepared import Prepared
from stylesplat.structure_from_motion.likeness import alike
from stylesplat.structure_from_motion.match_table import MatchTable
from stylesplat.structure_from_motion.pairs import most_alike
from stylesplat.structure_from_motion.reconstruct import reconstruct
from stylesplat.structure_from_motion.sfm_config import SfmConfig

class Killer(Silence):
    def task(self, what, *rest):
        if what == "matching photos":
            os.kill(os.getpid(), signal.SIGKILL)
        return super().task(what, *rest)

listen(Killer())
place, names = Path(sys.argv[1]), tuple(sys.argv[2:])
prepared = Prepared(names, ordered=False, origins={}, sharpness={})
reconstruct(place / "photos", prepared, place / "work", config=SfmConfig(max_features=500))
"""


def test_after_a_kill_the_next_call_goes_on(tmp_path: Path):
    prepared = write_photos(tmp_path / "photos", corner(4))
    environment = os.environ | {"PYTHONPATH": str(Path(stylesplat.__file__).parents[1])}
    command = [sys.executable, "-c", KILLED, tmp_path, *prepared.names]
    assert subprocess.run(command, env=environment).returncode == -signal.SIGKILL
    again = Recorder()
    with observed(again):
        result = reconstruct(tmp_path / "photos", prepared, tmp_path / "work", config=FAST)
    assert again.tasks == ["matching photos", "finding poses"]
    assert result.numbers["registered"] == 4


def test_photos_that_look_alike_are_compared(photos: Path, work: Path, result, prepared):
    place = open_workplace(work, photos, prepared.names, FAST)
    likeness = alike(place)
    assert likeness[3, 4] > 10 * likeness[3, COUNT + 1]  # the neighbour; another place
    assert likeness[COUNT].sum() == 0  # the blank photo
    pairs = most_alike(likeness, 4)
    assert {(row, row + 1) for row in range(COUNT - 1)} <= pairs
