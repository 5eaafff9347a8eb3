from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageCms

import stylesplat
from capture_files import corner, photograph_corner, places_around, towards, turned, write_photos
from colmap_here import colmap_in_this_process  # noqa: F401  (a fixture)
from processes import no_room
from stylesplat.errors import StyleSplatError
from stylesplat.photo_libraries import pycolmap
from stylesplat.progress import Observer, observed
from stylesplat.structure_from_motion import reconstruct as module
from stylesplat.structure_from_motion.config import SfmConfig
from stylesplat.structure_from_motion.diagnostics import (
    are_apart,
    check_features,
    check_matches,
    check_models,
    why_unregistered,
)
from stylesplat.structure_from_motion.matching import (
    MatchTable,
    choose_pairs,
    image_similarity,
    sequential_pairs,
    similar_pairs,
)
from stylesplat.structure_from_motion.photos import PreparedPhotos, group_by_camera
from stylesplat.structure_from_motion.reconstruct import (
    Reconstruction,
    agree,
    has_one_scale,
    reconstruct,
    turned_alike,
    write_colmap,
)
from stylesplat.structure_from_motion.workspace import (
    open_workspace,
    use_simple_lenses,
)

COUNT = 10
FAST = SfmConfig(max_features=500)
BLANK, OTHER, BLURRED = "Ecke/leer.png", "anderswo.jpg", "bewegt.jpg"
MATS = towards(places_around(COUNT))


class Recorder(Observer):
    """Remembers the bars; raises in the middle of one, if told to."""

    def __init__(self, interrupted: str = ""):
        self.tasks: list[str] = []
        self.interrupted = interrupted

    @contextmanager
    def task(self, what: str, total: int | float | None, unit: str, done: int | float):
        self.tasks.append(what)
        yield self

    def advance(self, amount: int | float = 1) -> None:
        if amount and self.tasks[-1] == self.interrupted:
            raise KeyboardInterrupt


def run(folder: Path, prepared: PreparedPhotos, config: SfmConfig = FAST) -> Reconstruction:
    return reconstruct(folder / "photos", prepared, folder / "work", config=config)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("Fotos vom Flur")


@pytest.fixture(scope="module")
def prepared(folder: Path) -> PreparedPhotos:
    pictures = corner(COUNT, prefix="Ecke im Café/Blick ")
    pictures[BLANK] = np.full((240, 320), 90, np.uint8)
    pictures[OTHER] = photograph_corner(MATS[3], seed=9)
    pictures[BLURRED] = photograph_corner(MATS[5], seed=8)
    return write_photos(folder / "photos", pictures, sharpness={BLURRED: 0.2})


@pytest.fixture(scope="module")
def result(folder: Path, prepared: PreparedPhotos) -> Reconstruction:
    with observed(Recorder("matching photos")), pytest.raises(KeyboardInterrupt):
        run(folder, prepared)
    again = Recorder()
    with observed(again):
        result = run(folder, prepared)
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


@pytest.mark.parametrize(
    ("shared", "reason"),
    [
        (12, "more than 12 features with it, and a reliable pose takes 30"),
        (852, "no camera position fits"),
    ],
)
def test_photos_without_a_pose_have_a_reason(shared: int, reason: str, result, prepared):
    reasons = result.unregistered
    assert set(reasons) == {BLANK, OTHER, BLURRED}
    assert reasons[BLANK] == "too little texture: 0 features"
    assert reasons[OTHER].startswith("too far from the others")
    assert reasons[BLURRED] == "blurred: 20% as sharp as its neighbours"
    posed = prepared.names[0]
    table = MatchTable(COUNT, {("new.jpg", posed): shared, (posed, "new.jpg"): shared}, 0)
    reasons = why_unregistered([result.model], {"new.jpg": 1000}, {}, table, [posed, "new.jpg"])
    assert reasons.keys() == {"new.jpg"} and reason in reasons["new.jpg"]


def test_the_capture_is_one_of_pinhole_photos(result: Reconstruction, folder: Path, tmp_path: Path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for image in result.model.images.values():
        path = tmp_path / "photos" / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.open(folder / "photos" / image.name).save(path, icc_profile=profile)
    write_colmap(result.model, tmp_path / "photos", tmp_path)
    capture = stylesplat.load(tmp_path)
    assert len(capture) == COUNT and capture.points is not None and len(capture.points) > 200
    assert len(capture.points) == result.numbers["points"]
    assert capture.cameras.names[0] == "Ecke im Café/Blick 00.jpg"
    assert capture.photos[0].shape[1] > 300
    with Image.open(tmp_path / "images" / "Ecke im Café" / "Blick 00.jpg") as image:
        assert image.info["icc_profile"] == profile
    # Points lie on the features that they were made from
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    before = model.compute_mean_reprojection_error()
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() == pytest.approx(before, rel=0.02)


def test_the_same_call_gives_the_same_poses_and_finds_nothing_again(result, folder, prepared):
    again = Recorder()
    with observed(again):
        repeated = run(folder, prepared)
    assert again.tasks == ["finding poses"]
    one, other = (poses(r.model, prepared.names[:COUNT]) for r in (result, repeated))
    np.testing.assert_allclose(one, other, atol=1e-6)  # threads add in any order


def test_pairs_of_many_photos(result, folder: Path, prepared):
    similar = SfmConfig(max_features=500, matching="similar")
    workspace = open_workspace(folder / "work", folder / "photos", prepared.names, similar)
    similarity = image_similarity(workspace)
    assert similarity[3, 4] > 10 * similarity[3, COUNT + 1]  # the neighbour; another place
    assert similarity[COUNT].sum() == 0  # the blank photo
    pairs = similar_pairs(similarity, 4)
    assert (
        {(row, row + 1) for row in range(COUNT - 1)}
        <= pairs
        <= choose_pairs(workspace, ordered=False)
    )
    sequential = SfmConfig(max_features=500, matching="sequential")
    workspace = open_workspace(folder / "work", folder / "photos", prepared.names, sequential)
    assert sequential_pairs(len(prepared.names)) <= choose_pairs(workspace, ordered=True)


def test_unusable_databases_are_made_anew(tmp_path: Path, said: list[str], capfd):
    prepared = write_photos(tmp_path / "photos", corner(3))

    def database(config: SfmConfig) -> Path:
        return open_workspace(
            tmp_path / "work", tmp_path / "photos", prepared.names, config
        ).database

    path = database(FAST)
    with pycolmap.Database.open(path) as opened:
        image = opened.read_image(1)
        image.name = "foreign.jpg"
        opened.update_image(image)
    database(FAST)
    assert len(said) == 1 and "features are new" in said[0]
    database(SfmConfig(max_features=400))
    assert len(said) == 2
    path.write_bytes(path.read_bytes()[:30000])
    database(SfmConfig(max_features=400))
    assert len(said) == 3
    assert capfd.readouterr().err == ""  # COLMAP says nothing of its own


@pytest.mark.usefixtures("colmap_in_this_process")
def test_lenses_are_made_simple_once(tmp_path: Path):
    prepared = write_photos(tmp_path / "photos", corner(COUNT))
    workspace = open_workspace(tmp_path / "work", tmp_path / "photos", prepared.names, FAST)

    def cameras() -> list[pycolmap.Camera]:
        with workspace.open_database() as database:
            return database.read_all_cameras()

    before = cameras()
    assert [each.model for each in before] == [pycolmap.CameraModelId.OPENCV]
    assert use_simple_lenses(workspace) and not use_simple_lenses(workspace)
    (after,) = cameras()
    assert after.model == pycolmap.CameraModelId.SIMPLE_RADIAL and after.verify_params()
    assert after.mean_focal_length() == before[0].mean_focal_length()
    assert after.params[1:].tolist() == [before[0].width / 2, before[0].height / 2, 0]


@pytest.mark.usefixtures("colmap_in_this_process")
def test_photos_from_one_place_make_no_scene(tmp_path: Path):
    photos = {f"{i}.jpg": photograph_corner(mat) for i, mat in enumerate(turned(7))}
    prepared = write_photos(tmp_path / "photos", photos)
    with pytest.raises(StyleSplatError, match=r"taken from one place.*Walk around"):
        run(tmp_path, prepared)


def test_what_makes_no_scene(result: Reconstruction):
    table = MatchTable(100, {("a", "b"): 40, ("b", "a"): 40}, 0)
    model = result.model
    cases: list[tuple[Callable[..., None], tuple[Any, ...], str]] = [
        (check_features, ({"a": 20, "b": 300}, 3), "too little to see .* 20 features"),
        (check_matches, (table,), "do not overlap: 1 of 100 pairs match"),
        (check_models, ([], table, 9), "No three of the 9 photos fit together"),
        (check_models, ([model, model], table, 31), "they fall into groups of 10, 10 of 31"),
        (check_models, ([model], table, 31), "Only 10 of 31 photos fit together: 1 of 100"),
    ]
    for check, arguments, message in cases:
        with pytest.raises(StyleSplatError, match=message):
            check(*arguments)


def test_of_several_places_the_largest_is_taken(result: Reconstruction, prepared):
    table = MatchTable(100, {("a", "b"): 40, ("b", "a"): 40}, 0)
    check_models([result.model, result.model], table, 20)
    other = pycolmap.Reconstruction(result.model)
    for image in other.images.values():
        image.name = f"B/{image.name}"
    names = [*prepared.names[:COUNT], *(f"B/{name}" for name in prepared.names[:COUNT])]
    counts = dict.fromkeys(names, 1000)
    reasons = why_unregistered([result.model, other], counts, {}, table, names)
    assert set(reasons.values()) == {"shows another place, with 9 other photos"}
    assert are_apart([result.model, other], table), "a and b are in neither"
    between = MatchTable(100, {(names[0], names[-1]): 40}, 0)
    assert not are_apart([result.model, other], between) and not are_apart([other], table)


@pytest.mark.usefixtures("colmap_in_this_process")
def test_photos_that_share_little_are_posed_by_few_points(tmp_path: Path, said: list[str]):
    """By 30 points three or four of these six are, as COLMAP does."""
    pictures = dict([*corner(16).items()][::3])
    found = run(tmp_path, write_photos(tmp_path / "photos", pictures), SfmConfig(max_features=150))
    assert found.numbers["registered"] == 6 and not said, "no finer features are looked for"
    turns = poses(found.model, [*pictures])[:, :, :3]
    truth = towards(places_around(16, spread=1.6))[::3, :3, :3]
    errors = np.einsum("cij,dkj,dkl,cml->cdim", turns, turns, truth, truth)
    cosines = (np.trace(errors, axis1=2, axis2=3) - 1) / 2
    assert np.degrees(np.arccos(cosines.clip(-1, 1))).max() < 1


@pytest.mark.usefixtures("colmap_in_this_process")
def test_where_few_photos_fit_together_finer_features_are_found(
    tmp_path: Path, said: list[str], monkeypatch: pytest.MonkeyPatch
):
    """So few features as the first time looks for join some of six photos that are far apart."""
    monkeypatch.setattr(module, "MOSTLY_POSED", 1.1)  # how many they are depends on the threads
    pictures = dict([*corner(16).items()][::3])
    prepared = write_photos(tmp_path / "photos", pictures)
    found = run(tmp_path, prepared, SfmConfig(max_features=150))
    (line,) = said
    assert "of 6 photos fit together so far: looking for finer features." in line
    assert found.numbers["registered"] == len(pictures) and not found.unregistered


@pytest.mark.usefixtures("colmap_in_this_process")
@pytest.mark.parametrize(
    ("most", "what", "compared"),
    [
        (15, "all pairs of photos", 15),
        (7, "the 7 most similar pairs of photos of different groups", 4 + 7),
    ],
)
def test_where_few_photos_fit_together_more_pairs_are_compared(
    tmp_path: Path,
    said: list[str],
    monkeypatch: pytest.MonkeyPatch,
    most: int,
    what: str,
    compared: int,
):
    """Pairs of similar photos may join too few; of many photos, at first only these are matched."""
    monkeypatch.setattr(module, "ALL_PAIRS", most)
    monkeypatch.setattr(module, "choose_pairs", lambda *_, **__: {(0, 1), (1, 2), (3, 4), (4, 5)})
    prepared = write_photos(tmp_path / "photos", dict([*corner(12).items()][::2]))
    found = run(tmp_path, prepared)
    (line,) = said
    assert line == f"Only 3 of 6 photos fit together so far: comparing {what}."
    assert found.numbers["registered"] == 6 and found.numbers["compared_pairs"] == compared


def test_mappers_agree_where_photos_are_turned_alike(result: Reconstruction):
    assert agree(result.model, result.model)
    other = pycolmap.Reconstruction(result.model)
    moved = pycolmap.Sim3d(2.0, pycolmap.Rotation3d([0.0, 0.6, 0.0, 0.8]), [1.0, 2.0, 3.0])
    other.transform(moved)
    assert agree(result.model, other), "another world"
    names = [image.name for image in other.images.values()]
    for image, name in zip(other.images.values(), names[::-1], strict=True):
        image.name = name
    assert not agree(result.model, other) and not turned_alike(result.model, other)


def test_a_group_in_a_corner_of_the_other_is_found_out(result: Reconstruction):
    assert has_one_scale(result.model)
    far = pycolmap.Reconstruction(result.model)
    for row, image in enumerate(far.images.values()):
        if row % 3 == 0:
            pose = image.cam_from_world()
            pose.translation = 30 * pose.translation
            far.frames[image.frame_id].set_cam_from_world(image.camera_id, pose)
    assert not has_one_scale(far) and not agree(result.model, far)
    assert turned_alike(result.model, far), "whatever the distance"


def test_after_a_full_disk_the_next_call_continues(tmp_path: Path):
    prepared = write_photos(tmp_path / "photos", corner(4))
    with no_room(200_000), pytest.raises(StyleSplatError, match=r"Cannot write .*: disk full"):
        run(tmp_path, prepared)
    assert run(tmp_path, prepared).numbers["registered"] == 4


def test_no_second_sqlite_is_loaded():
    """COLMAP brings its own; Python's would be another one, and they undo each other's locks."""
    code = "\n".join(path.read_text() for path in Path(stylesplat.__file__).parent.rglob("*.py"))
    assert "import pycolmap" in code and "import sqlite3" not in code


def test_each_size_and_lens_has_a_camera(tmp_path: Path):
    write_photos(tmp_path, corner(3))
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength] = 4.2
    Image.open(tmp_path / "00.jpg").save(tmp_path / "03.jpg", exif=exif)
    Image.open(tmp_path / "00.jpg").resize((160, 120)).save(tmp_path / "04.jpg")
    names = [f"0{i}.jpg" for i in range(5)]

    assert group_by_camera(tmp_path, names, "auto") == [[0, 1, 2], [3], [4]]
    assert group_by_camera(tmp_path, names, "one") == [[0, 1, 2, 3], [4]]
    assert group_by_camera(tmp_path, names, "several") == [[0], [1], [2], [3], [4]]
