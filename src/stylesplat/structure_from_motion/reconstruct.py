"""From photos to cameras and points, and to photos without distortion."""

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import procrustes

from stylesplat.errors import StyleSplatError, count_noun
from stylesplat.io.atomic import locked_folder
from stylesplat.io.captures.colmap import posed_images
from stylesplat.io.captures.colmap_files import check_complete
from stylesplat.io.captures.lens import Lens, places_in
from stylesplat.io.captures.photos import Photo
from stylesplat.io.files import cannot_write, resolve_within
from stylesplat.io.images import image_sizes, straight_alpha, write_image
from stylesplat.photo_libraries import pycolmap
from stylesplat.progress import say
from stylesplat.structure_from_motion.config import MIN_PHOTOS, SfmConfig
from stylesplat.structure_from_motion.crop_alike import crop_alike, find_offsets
from stylesplat.structure_from_motion.diagnostics import (
    MANY_MOTIONS,
    TurningNotPosed,
    are_apart,
    check_features,
    check_matches,
    check_models,
    is_without_depth,
    why_unregistered,
)
from stylesplat.structure_from_motion.matching import (
    MatchTable,
    choose_pairs,
    image_similarity,
    match_pairs,
    orbit_pairs,
    pairs_between,
)
from stylesplat.structure_from_motion.object_features import (
    NO_MOTION,
    MaskReaders,
    MatchedFeatures,
    PhotoBox,
    TwoMotions,
    find_two_motions,
    pixels_near_features,
    read_matches,
    spread_box,
    write_masks,
)
from stylesplat.structure_from_motion.one_axis import turn_on_one_axis
from stylesplat.structure_from_motion.photos import PreparedPhotos, color_profile, map_photos
from stylesplat.structure_from_motion.workspace import (
    Workspace,
    extract_features,
    feature_counts,
    open_workspace,
    use_simple_lenses,
)

MIN_TRACK = 3  # photos that see a point: the error of points of two is several times as large


def write_colmap(model: pycolmap.Reconstruction, photos: Path, folder: Path) -> None:
    """Write the photos as pinhole cameras would have taken them, and the model of these.

    Photos go to `images/`, under their names, cameras and points to `sparse/0/`.
    """
    images = posed_images(model)
    lenses = {key: Lens.from_colmap(camera) for key, camera in model.cameras.items()}

    def write(image: pycolmap.Image) -> None:
        lens = lenses[image.camera_id]
        source = resolve_within(photos, image.name)
        target = resolve_within(folder / "images", image.name)
        photo = Photo(source, upright=True, lens=lens, size=lens.pinhole().size)
        pixels = straight_alpha(photo.read_with_alpha().numpy())
        write_image(torch.from_numpy(pixels), target, icc_profile=color_profile(source))

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


RECONSTRUCT_STAGES = ("features", "matching", "mapping")
# Share of the photos: where fewer fit together, finer features are looked for, so many times more
MOSTLY_POSED, CLOSER = 0.75, 4
# Matches from which a pair counts for the global mapper, one after the other until its model is to
# be trusted: few wrong pairs tear it apart. Of the cape, whose ornament repeats, all 56 photos had
# the incremental mapper's poses with 20, 25 and 40, whatever the seed, and not with 15 and 30
PAIR_MATCHES = 15, 20, 30, 40
# Common points that are enough for a pose, where COLMAP's 30 leave most photos out. Of 131 photos
# of a statue from many cameras and seasons, all pairs matched, the two largest groups had 40 and 13
# photos with 30, 65 and 28 with 15, 127 and 7 with 10: all within 12 degrees of known poses
FEW_POINTS = 10
ALL_PAIRS = 20_000  # at most, which are compared before: those of 200 photos take some 4 minutes
# Degrees between poses of two mappers, and shares of their spread, from which one of them is wrong
SAME_TURN, SAME_PLACE = 5.0, 0.1
# Times as far from the middle as most cameras are: the cape had 1.2 where it was right, 19 where a
# second group lay in a corner
SAME_SCALE = 6.0
MIN_POSED = 0.9  # share of the photos that is enough, also of a closed orbit


@dataclass(frozen=True)
class Reconstruction:
    """Where photos were taken, and the points that they show."""

    model: pycolmap.Reconstruction
    """The largest group of photos that fit together, under the caller's names."""
    photos: Path
    """Their folder: another than was given if they were cut."""
    unregistered: dict[str, str]
    """By name why a photo is not in it."""
    numbers: dict[str, Any]
    """Counts, the mean reprojection error and the seconds of each stage."""


def reconstruct(
    photos: Path,
    prepared: PreparedPhotos,
    work: Path,
    *,
    config: SfmConfig,
    masks: MaskReaders | None = None,
    box: tuple[str, PhotoBox] | None = None,
    turntable: bool = False,
) -> Reconstruction:
    """Extract features, match them and map the photos.

    Of masks, one for each photo, features outside are ignored; a box around an object in a photo
    is spread to masks of all. On a turntable, whose camera stands still, photos in order are
    matched with their neighbours, and turn about one axis. Where features tell that something moves
    while much stays, what moves is posed. An interrupted call loses nothing that its database
    holds: the next one with the same photos and settings continues.
    """
    names, times = prepared.names, [time.perf_counter()]
    motions = NO_MOTION
    with locked_folder(work):
        if box is not None:
            apart = _match(work / "object", photos, prepared, config)
            features = read_matches(apart)
            motions = find_two_motions(*features, _sides(photos, names))
            shown = replace(motions, photo=names.index(box[0]), box=box[1])
            photos, masks = _object_alone(apart, photos, features, shown)
            turntable |= motions.share >= MANY_MOTIONS
        folder = None if masks is None else write_masks(masks, photos, names, work / "masks")
        workspace = open_workspace(work, photos, names, config, folder)
        extract_features(workspace)
        counts = feature_counts(workspace)
        check_features(counts, len(names))
        times.append(time.perf_counter())
        models, table, turned, matched = list[pycolmap.Reconstruction](), None, False, 0.0
        may_turn = turntable or prepared.cut_outs
        if may_turn and prepared.ordered and config.matching == "auto":
            table, matched = match_pairs(workspace, orbit_pairs(len(names))), time.perf_counter()
            if (names[0], names[-1]) in table.matches:
                models, turned = _map_orbit(workspace)
        is_orbit = turned or (turntable and bool(models))
        if table is None or not is_orbit or _posed(models) < MIN_POSED * len(names):
            table = match_pairs(workspace, choose_pairs(workspace, ordered=prepared.ordered))
            check_matches(table)
            if folder is None:
                features = read_matches(workspace)
                motions = find_two_motions(*features, _sides(photos, names))
                if motions.share >= MANY_MOTIONS:
                    return _pose_what_moves(workspace, photos, features, prepared, motions, config)
                del features  # mapping needs the memory
            matched = time.perf_counter()
            models = _map_photos(workspace)
            turned = turntable and bool(models) and turn_on_one_axis(models[0], names)
        if _posed(models) < MOSTLY_POSED * len(names) and not is_without_depth(models, table):
            models, counts, table = _look_closer(workspace, photos, models, counts, table)
        times += [matched, time.perf_counter()]
    check_models(models, table, len(names))
    model = models[0]
    return Reconstruction(
        model=model,
        photos=photos,
        unregistered=why_unregistered(models, counts, prepared.sharpness, table, names),
        numbers={
            "photos": len(names),
            "registered": model.num_reg_images(),
            "points": len(reliable_points(model)),
            "reprojection_error": model.compute_mean_reprojection_error(),
            "compared_pairs": table.compared,
            "matched_pairs": table.matched,
            "models": len(models),
            "pairs_with_two_motions": round(motions.share, 3),
            "turns_on_one_axis": turned,
            "seconds": {
                stage: round(end - start, 2)
                for stage, start, end in zip(RECONSTRUCT_STAGES, times, times[1:], strict=False)
            },
        },
    )


def _pose_what_moves(
    workspace: Workspace,
    photos: Path,
    features: MatchedFeatures,
    prepared: PreparedPhotos,
    motions: TwoMotions,
    config: SfmConfig,
) -> Reconstruction:
    """Pose what moves before a room that does not; raises a `TurningNotPosed` where that fails."""
    say(
        f"In {motions.share:.0%} of the pairs of photos much stays while the rest moves: what "
        "moves is posed."
    )
    try:
        cropped, masks = _object_alone(workspace, photos, features, motions)
        work = workspace.folder / "moving"
        found = reconstruct(cropped, prepared, work, config=config, masks=masks, turntable=True)
        count, total = found.model.num_reg_images(), len(prepared.names)
        if count >= MIN_POSED * total:
            share = {"pairs_with_two_motions": round(motions.share, 3)}
            return replace(found, numbers=found.numbers | share)
        fault = f"Only {count} of {count_noun(total, 'photo')} fit together."
    except StyleSplatError as error:
        fault = str(error)
    raise TurningNotPosed(fault, prepared.names[motions.photo], motions.box)


def _look_closer(
    workspace: Workspace,
    photos: Path,
    models: list[pycolmap.Reconstruction],
    counts: dict[str, int],
    table: MatchTable,
) -> tuple[list[pycolmap.Reconstruction], dict[str, int], MatchTable]:
    """What a simple lens, all pairs of photos and finer features tell, where few fit together.

    Returns what poses most, or what there is.
    """
    names, mapped, tries = workspace.names, models, [(models, counts, table)]
    if use_simple_lenses(workspace):
        say(f"{_fit_together(models, names)}: trying a simpler lens.")
        mapped = _map_photos(workspace)
        models = max(models, mapped, key=_posed)
        tries.append((models, counts, table))
        if _posed(models) >= MOSTLY_POSED * len(names):
            return tries[-1]
    every = set(combinations(range(len(names)), 2))
    if table.compared < len(every) and workspace.config.matching == "auto":
        what = "all pairs of photos"
        if len(every) > ALL_PAIRS:
            what = f"the {ALL_PAIRS:,} most similar pairs of photos of different groups"
            every = pairs_between(image_similarity(workspace), _groups(models, names), ALL_PAIRS)
        say(f"{_fit_together(models, names)}: comparing {what}.")
        table = match_pairs(workspace, every)
        models = mapped = _map_photos(workspace)  # poses from similar pairs alone may be wrong
        tries.append((models, counts, table))
    tries += [(each, counts, table) for each in _map_both_ways(workspace, models, mapped)]
    best = max(tries, key=lambda each: _posed(each[0]))
    grouped = sum(each.num_reg_images() for each in best[0])
    if _posed(best[0]) >= MOSTLY_POSED * len(names) or (
        grouped >= MOSTLY_POSED * len(names) and are_apart(best[0], best[2])
    ):
        return best
    say(f"{_fit_together(best[0], names)}: looking for finer features.")
    config = replace(workspace.config, max_features=CLOSER * workspace.config.max_features)
    folder = workspace.folder / "closer"
    # Few photos do not tell more of a lens: with OPENCV's the second joined groups in two scales
    closer = open_workspace(folder, photos, names, config, workspace.masks, simple_lens=True)
    extract_features(closer, finest=True)
    found, finer = match_pairs(closer, choose_pairs(closer, ordered=False)), feature_counts(closer)
    tries += [(each, finer, found) for each in _map_both_ways(closer, best[0])]
    return max(tries, key=lambda each: _posed(each[0]))


def _groups(models: Sequence[pycolmap.Reconstruction], names: Sequence[str]) -> list[int]:
    """A number for each photo, the same for those of one model."""
    posed = [{i.name for i in model.images.values() if i.has_pose} for model in models]
    return [
        next((group for group, own in enumerate(posed) if name in own), -1 - row)
        for row, name in enumerate(names)
    ]


def _fit_together(models: list[pycolmap.Reconstruction], names: Sequence[str]) -> str:
    return f"Only {_posed(models)} of {len(names)} photos fit together so far"


def _map_both_ways(
    workspace: Workspace,
    known: list[pycolmap.Reconstruction],
    mapped: list[pycolmap.Reconstruction] | None = None,
) -> list[list[pycolmap.Reconstruction]]:
    """The models by COLMAP's incremental mapper, and by its global one if they are to be trusted.

    The first needs only `FEW_POINTS` for a pose, and is trusted where photos are turned as in the
    largest model that is known; else the models by 30 points count, which are `mapped` or are made
    here. If it leaves out more than a tenth of the photos, the second is tried, which joins photos
    that are far apart (of 29 of a golden cape, whose highlights wander, 22 instead of 8; of all 56
    the whole circle instead of 45; with 30 points for a pose). It is trusted where its poses are
    those of the first and of the known model, or those of an object alone that turns on one axis.
    """
    in_turn = _map_photos(workspace, points=FEW_POINTS)
    if not in_turn or not (
        has_one_scale(in_turn[0]) and all(turned_alike(in_turn[0], each) for each in known[:1])
    ):
        in_turn = _map_photos(workspace) if mapped is None else mapped
    if _posed(in_turn) >= MIN_POSED * len(workspace.names):
        return [in_turn]
    others = (*in_turn[:1], *known[:1])
    for least in PAIR_MATCHES:
        at_once = _map_photos(workspace, "map_photos_at_once", least=least)
        if at_once and (
            (workspace.masks is not None and turn_on_one_axis(at_once[0], workspace.names))
            or (has_one_scale(at_once[0]) and all(agree(at_once[0], each) for each in others))
        ):
            return [in_turn, at_once]
    return [in_turn]


def _posed(models: Sequence[pycolmap.Reconstruction]) -> int:
    """How many photos the largest model has; they are in order."""
    return models[0].num_reg_images() if models else 0


def has_one_scale(model: pycolmap.Reconstruction) -> bool:
    """Whether most cameras are about as far from what they show; see `agree`."""
    middle = np.median([point.xyz for point in model.points3D.values()], axis=0)
    places = [image.projection_center() for image in model.images.values() if image.has_pose]
    distances = np.linalg.norm(np.stack(places) - middle, axis=1)
    return bool(np.quantile(distances, 0.9) < SAME_SCALE * np.median(distances))


def agree(one: pycolmap.Reconstruction, other: pycolmap.Reconstruction) -> bool:
    """Whether the photos of both are turned and placed alike against each other, mostly.

    The global mapper may join two groups in scales of their own: then one lies in a corner of the
    other.
    """
    shared = _posed_in_both(one, other)
    if len(shared) < MIN_PHOTOS:
        return True  # they say nothing of each other
    places = [np.stack([i.projection_center() for i in each]) for each in zip(*shared, strict=True)]
    fitted, moved, _ = procrustes(places[1], places[0])  # whose squares add up to 1
    apart = np.linalg.norm(fitted - moved, axis=1)
    is_near = np.quantile(apart, 0.9) <= SAME_PLACE / np.sqrt(len(shared))
    return bool(is_near) and turned_alike(one, other)


def turned_alike(one: pycolmap.Reconstruction, other: pycolmap.Reconstruction) -> bool:
    """Whether the photos of both are turned alike against each other, mostly.

    Places may differ: from afar a longer focal length looks like a larger distance.
    """
    shared = _posed_in_both(one, other)
    if len(shared) < MIN_PHOTOS:
        return True
    turns = [
        np.stack([image.cam_from_world().rotation.matrix() for image in each])
        for each in zip(*shared, strict=True)
    ]
    relative = [np.einsum("iab,jcb->ijac", each, each) for each in turns]
    traces = np.einsum("ijab,ijab->ij", *relative)[np.triu_indices(len(shared), 1)]
    return float(np.median(np.degrees(np.arccos(((traces - 1) / 2).clip(-1, 1))))) < SAME_TURN


def _posed_in_both(
    one: pycolmap.Reconstruction, other: pycolmap.Reconstruction
) -> list[tuple[pycolmap.Image, pycolmap.Image]]:
    of_one, of_other = (
        {i.name: i for i in each.images.values() if i.has_pose} for each in (one, other)
    )
    return [(of_one[name], of_other[name]) for name in sorted(of_one.keys() & of_other.keys())]


def _match(work: Path, photos: Path, prepared: PreparedPhotos, config: SfmConfig) -> Workspace:
    """A workspace of its own with all features of the photos and their matches."""
    workspace = open_workspace(work, photos, prepared.names, config)
    extract_features(workspace)
    match_pairs(workspace, choose_pairs(workspace, ordered=prepared.ordered))
    return workspace


def _object_alone(
    workspace: Workspace, photos: Path, features: MatchedFeatures, shown: TwoMotions
) -> tuple[Path, MaskReaders]:
    """The photos, cropped alike if they were not, and masks of the object that a box is around."""
    names, first, box, (places, matches) = workspace.names, shown.photo, shown.box, features
    sizes = [image_sizes(resolve_within(photos, name))[0] for name in names]
    sides = [max(size) for size in sizes]
    if shown.share >= MANY_MOTIONS:
        offsets = find_offsets(places, matches, sides)
        if offsets.any():
            most = np.ptp(offsets, axis=0).max()
            folder = workspace.folder / "cropped"
            corners, size = crop_alike(photos, names, offsets, folder)
            say(
                f"The photos were cropped in their own ways, by up to {most:.0f} pixels: they are "
                f"cropped to the {size[0]}x{size[1]} that all show of the room."
            )
            photos, sizes = folder, [size] * len(names)
            places = [each - corner for each, corner in zip(places, corners, strict=True)]
            x, y = corners[first].tolist()
            box = box[0] - x, box[1] - y, box[2] - x, box[3] - y
    shares = spread_box(places, matches, sides, first, box)
    if not (shares[first] > 0).any():
        raise StyleSplatError(
            f"The box in {names[first]} shows nothing that can be found again. Draw a larger one."
        )
    regions = [
        partial(pixels_near_features, *each) for each in zip(places, shares, sizes, strict=True)
    ]
    return photos, dict(zip(names, regions, strict=True))


def _sides(photos: Path, names: Sequence[str]) -> list[int]:
    """The longer sides of photos."""
    return [max(image_sizes(resolve_within(photos, name))[0]) for name in names]


def _map_orbit(workspace: Workspace) -> tuple[list[pycolmap.Reconstruction], bool]:
    """The models of an object that turns before a still camera, and whether they turn on one axis.

    Of two mappers the one counts that poses more photos, and of the same number the one with less
    error. All at once are often more: of 36 photos of a smooth toy 36 instead of 13.
    """
    found = list[tuple[list[pycolmap.Reconstruction], bool]]()
    for stage in ("map_photos", "map_photos_at_once"):
        if models := _map_photos(workspace, stage):
            found.append((models, turn_on_one_axis(models[0], workspace.names)))

    def rank(each: tuple[list[pycolmap.Reconstruction], bool]) -> tuple[bool, int, float]:
        (model, *_), turned = each
        return turned, model.num_reg_images(), -model.compute_mean_reprojection_error()

    return max(found, key=rank, default=([], False))


def _map_photos(
    workspace: Workspace, stage: str = "map_photos", **settings: Any
) -> list[pycolmap.Reconstruction]:
    """The models of the photos, under the caller's names; the largest first.

    By COLMAP's incremental mapper: on desk the global one left out 2 to 6 of 51 photos or was half
    as exact, in the same time.
    """
    folder = workspace.folder / "models"
    shutil.rmtree(folder, ignore_errors=True)
    settings |= {"models": str(folder)}
    workspace.run(stage, "finding poses", len(workspace.names), "photo", **settings)
    models = [pycolmap.Reconstruction(each) for each in sorted(folder.iterdir())]
    shutil.rmtree(folder, ignore_errors=True)
    for model in models:
        for image in model.images.values():
            image.name = workspace.name_of[image.name]
    return sorted(models, key=lambda model: -model.num_reg_images())
