"""`sfm`: photos or a video in, a capture with poses out; `check`: whether it is good enough."""

import shutil
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool

from stylesplat.errors import StyleSplatError, count_noun, join_names, printable, shell_command
from stylesplat.figures.capture_picture import capture_picture
from stylesplat.io.atomic import atomic_folder, locked_folder, progress_path, refuse_occupied
from stylesplat.io.captures.capture_folder import (
    CUT_OUT_NAMES,
    OBJECT_MASK,
    SFM_FILE,
    SfmRecord,
    TakenLens,
    load,
    open_capture,
    unposed_photos,
    with_drawn_maps,
    write_sfm,
)
from stylesplat.io.captures.colmap import ModelFigures, posed_images, read_figures
from stylesplat.io.files import resolve_within
from stylesplat.io.images import image_sizes, write_image
from stylesplat.io.kinds import refuse_other_than_photos
from stylesplat.io.label_maps import DrawnLabels, FoundMasks, write_label_maps
from stylesplat.masks.import_masks import check_mask_source, import_label_maps
from stylesplat.options import (
    BOX,
    Places,
    check_arguments,
    check_box,
    with_settings,
)
from stylesplat.photo_libraries import av, cv2, pycolmap
from stylesplat.progress import say
from stylesplat.scene.cameras import find_name
from stylesplat.scene.capture import BACKGROUND, Capture, Mask, OwnLabels
from stylesplat.scene.frames import Frame
from stylesplat.scene.sequences import Lazy
from stylesplat.structure_from_motion import diagnostics
from stylesplat.structure_from_motion.config import SfmConfig
from stylesplat.structure_from_motion.diagnostics import (
    MANY_MOTIONS,
    CaptureReport,
    Finding,
    TurningNotPosed,
)
from stylesplat.structure_from_motion.earlier_capture import source_digest
from stylesplat.structure_from_motion.image_measures import MEASURE_SIDE
from stylesplat.structure_from_motion.object_features import (
    MaskReaders,
    PhotoBox,
    cut_out_mask,
    cut_out_pixels,
)
from stylesplat.structure_from_motion.one_axis import find_missing_sides
from stylesplat.structure_from_motion.photos import PreparedPhotos
from stylesplat.structure_from_motion.prepare import prepare
from stylesplat.structure_from_motion.reconstruct import (
    MIN_POSED,
    Reconstruction,
    reconstruct,
    write_colmap,
)
from stylesplat.structure_from_motion.turntable import Turntable, find_turntable
from stylesplat.structure_from_motion.world_frame import (
    find_centre,
    measure_coverage,
    measure_photos,
    move_to_working_frame,
    working_frame,
)
from stylesplat.training.object_alone import fog_advice, outline_moving_object


@check_arguments
def check(capture: Capture) -> CaptureReport:
    """Look at a capture: its photos, each once, its poses, points and reconstruction.

    Where the capture was read from a folder, the reconstruction that lies there counts as well,
    and which photos there have no pose.

    Args:
        capture: Posed photos; a size of 640 pixels suffices.

    Raises:
        StyleSplatError: If a photo or the reconstruction is damaged.
    """
    capture = capture.without_outliers()
    cameras, points = capture.cameras, capture.points
    frame = working_frame(cameras, torch.zeros(0, 3) if points is None else points)
    outward = find_centre(cameras, points).outward
    coverage = measure_coverage(cameras, frame, outward=outward)
    figures = None if capture.path is None else read_figures(capture.path)
    photos = measure_photos(capture)
    return CaptureReport(
        findings=(
            diagnostics.diagnose_count(len(capture)),
            *_on_reconstruction(capture, figures),
            diagnostics.diagnose_sides(coverage, len(capture)),
            diagnostics.diagnose_heights(coverage),
            diagnostics.diagnose_distances(coverage),
            *diagnostics.diagnose_photos(photos, cameras.names),
        ),
        blurred=tuple(cameras.names[row] for row in diagnostics.blurred_rows(photos)),
        weak=tuple(diagnostics.weakly_connected(figures.shared) if figures else ()),
        coverage=coverage,
        frame=frame,
    )


def advices(report: CaptureReport, *, known: Collection[str] = ()) -> list[str]:
    """The poor and then the fair findings, a line each; of `known` findings the advice alone."""
    lines = [
        each.advice if each.what in known else each.line
        for verdict in ("poor", "fair")
        for each in report.findings
        if each.verdict == verdict
    ]
    return [line[:1].upper() + line[1:] for line in lines]


def _on_reconstruction(capture: Capture, figures: ModelFigures | None) -> list[Finding]:
    found = []
    if capture.path is not None:
        posed = {*capture.cameras.names, *capture.outliers.photos}
        unposed, left_out = unposed_photos(capture.path, posed)
        found.append(diagnostics.diagnose_poses(len(posed), unposed, left_out))
    if capture.outliers:
        found.append(diagnostics.diagnose_outliers(capture.outliers))
    found += diagnostics.diagnose_model(figures) if figures else []
    points = capture.points
    return [*found, diagnostics.diagnose_points(0 if points is None else len(points))]


SFM_PICTURE = "check.jpg"  # of cameras and points, in the capture
LISTED = 8  # photos that a line names


@check_arguments
def sfm(
    source: Path | str,
    output: Path | str,
    *,
    frames: int = 100,
    masks: Path | str | None = None,
    box: Places | None = None,
    overwrite: bool = False,
    **settings: Any,
) -> Capture:
    """Find the cameras of photos or of a video, by structure from motion with COLMAP.

    Near-duplicates and very blurred photos are left out. An object that turns before a camera that
    stands still is found and posed, and the capture gets its label maps; otherwise `masks` or a
    `box` may say what is posed, and what lies outside is ignored. Cut-outs, whose surroundings are
    transparent or plain, are posed by what they show.

    The world gets a frame that people can work in: up is -y, the content is around the origin, and
    the median distance of the cameras from it is 1. What is done so far is kept in a folder beside
    `output`, from where an interrupted call goes on.

    Args:
        source: A folder of photos, sub-folders included, or a video.
        output: The folder of the capture to make: photos without distortion, poses and points in
            COLMAP's layout, and `sfm.json`, which says what became of each photo.
        frames: About how many frames of a video to take.
        masks: A folder of pictures named like the photos, or COCO JSON; black is ignored.
        box: A photo and a rectangle around the object in it, `(view, x0, y0, x1, y1)` in its
            pixels, from where the object is followed into the other photos.
        overwrite: Whether `output` may hold an earlier result; its label maps are kept.
        settings: Fields of `SfmConfig` to change, such as `matching="sequential"`.

    Returns:
        The capture, as `load` reads it.

    Raises:
        StyleSplatError: If there are fewer than three photos that are fit for it, their cameras
            cannot be found, or the capture cannot be made there; it says what would help.
        KeyboardInterrupt: After Ctrl-C, with what is done so far kept.

    Example:
        >>> import stylesplat as ss
        >>> capture = ss.sfm("MyPhotos/", "MyPhotos-capture/")  # doctest: +SKIP
    """
    config = with_settings(SfmConfig(), settings)
    source, output = Path(source), Path(output).resolve()
    _refuse_places(source, output, masks, box)
    work = progress_path(output) / "sfm"
    photos = work / "prepared"
    with locked_folder(output):
        refuse_occupied(output, marker=SFM_FILE, overwrite=overwrite)
        digest = source_digest(source)
        prepared = prepare(source, photos, frames=frames)
        drawn = None if masks is None else _drawn_on(Path(masks), prepared)
        turntable = None if prepared.cut_outs else find_turntable(photos, prepared.names)
        if turntable is not None:
            say("The camera stood still before an object that turns: the object is posed.")
        pose = partial(
            reconstruct,
            photos,
            prepared,
            work,
            config=config,
            masks=None if box is not None else _masks_of(source, prepared, drawn, turntable),
            box=None if box is None else _place_box(box, photos, prepared),
            turntable=turntable is not None,
        )
        if drawn is not None or box is not None:
            found = pose()
        else:
            found = _pose_or_name_box(pose, prepared, turntable, (source, "-o", output))
        frame = move_to_working_frame(found.model)
        turns = turntable is not None or found.numbers["pairs_with_two_motions"] >= MANY_MOTIONS
        with atomic_folder(output, overwrite=overwrite, marker=SFM_FILE) as new:
            write_colmap(found.model, found.photos, new)
            record = _record(source, digest, prepared, found, frame, config, turns=turns)
            record.settings |= {"masks": None if masks is None else str(masks), "box": box}
            write_sfm(record, new)
            report = _checked(new, output)
            if (output / OBJECT_MASK).is_dir():  # of an earlier capture; they may be handwork
                shutil.copytree(output / OBJECT_MASK, new / OBJECT_MASK, symlinks=True)
                say(f"The label maps in {output / OBJECT_MASK} are kept.")
            elif prepared.cut_outs and drawn is None and (capture := load(new)).alphas is None:
                say("The photos have a background of one colour: what stands out is the object.")
                _write_masks(capture, _cut_outs(source, prepared), new / OBJECT_MASK, output)
            elif turns:
                _write_masks(load(new), drawn, new / OBJECT_MASK, output)
        shutil.rmtree(work, ignore_errors=True)
        with suppress(OSError):  # something else lies beside it
            work.parent.rmdir()
    say(f"Posed {record.registered} of {record.given} photos.")
    for what, reasons in (("Left out", record.left_out), ("Not posed", record.unregistered)):
        for why in dict.fromkeys(reasons.values()):
            names = [name for name, other in reasons.items() if other == why]
            say(f"{what}: {join_names(names, LISTED)}: {why}.")
    for line in advices(report, known={"posed"}):
        say(line)
    if turns:
        boxed = drawn is not None or box is not None
        _mention_missing(found.model, prepared, source=None if boxed else source)
    return load(output)


def _mention_missing(
    model: pycolmap.Reconstruction, prepared: PreparedPhotos, *, source: Path | None
) -> None:
    """Say which part of a turn only photos without a pose show, and what helps.

    Photos that were left out are not considered. A box is offered where the photos are named:
    `source` is None where it or masks were given.
    """
    own = {name: join_names([prepared.origins[name]]) for name in prepared.names}
    sides = [
        f"{side.begin} to {side.end} ({own[side.first]} to {own[side.last]})"
        for side in find_missing_sides(model, prepared.names)
    ]
    if not sides:
        return
    remedy = "Take more photos of it, in small steps"
    if source is not None:
        command = shell_command("sfm", source, "-o", "CAPTURE", "--object", "VIEW:x0,y0,x1,y1")
        remedy += f", or draw a box around what has detail: `{command}`"
    say(
        f"Only {model.num_reg_images()} of {len(own)} photos of what turns have a pose. Missing, "
        f"in degrees from {own[prepared.names[0]]}: {'; '.join(sides)}. {remedy}."
    )


def _refuse_places(
    source: Path, output: Path, masks: Path | str | None, box: Places | None
) -> None:
    """Raise the errors of `sfm` that are known before the work."""
    if masks is not None and box is not None:
        raise StyleSplatError(
            "Masks and a box both say what to pose. Give one of them, --masks or --object."
        )
    if masks is not None:
        check_mask_source(Path(masks))
    refuse_other_than_photos(source)
    if output.is_relative_to(source.resolve()):
        raise StyleSplatError(f"{output} lies inside of {source}. Choose a folder outside of it.")
    if source.resolve().is_relative_to(output):
        raise StyleSplatError(
            f"{source} lies inside of {output}, which would be replaced. Choose another folder."
        )


def _masks_of(
    source: Path, prepared: PreparedPhotos, drawn: FoundMasks | None, turntable: Turntable | None
) -> MaskReaders | None:
    """What to find features in, by photo; None where that is everything."""
    if drawn is not None:
        return {name: partial(_shown, each) for name, each in drawn.maps.items()}
    if prepared.cut_outs:
        paths = {n: resolve_within(source, own) for n, own in prepared.origins.items()}
        return {name: partial(cut_out_mask, path) for name, path in paths.items()}
    return None if turntable is None else turntable.masks(prepared.names)


def _pose_or_name_box(
    pose: Callable[[], Reconstruction],
    prepared: PreparedPhotos,
    turntable: Turntable | None,
    arguments: tuple[object, ...],
) -> Reconstruction:
    """Pose the photos; where what turns is not posed, the error names `sfm` with a box."""
    try:
        return pose() if turntable is None else _pose_turning(pose, prepared, turntable)
    except TurningNotPosed as error:
        corners = ",".join(f"{edge:.0f}" for edge in error.box)
        box = f"{prepared.origins[error.photo]}:{corners}"
        raise StyleSplatError(
            f"Cannot pose the object that turns before a still background. {error} Put something "
            "with print beside it on the turntable, or draw a box around what has detail: "
            f"{shell_command('sfm', *arguments, '--object', box)}"
        ) from error


def _pose_turning(
    pose: Callable[[], Reconstruction], prepared: PreparedPhotos, turntable: Turntable
) -> Reconstruction:
    try:
        found = pose()
        count, total = found.model.num_reg_images(), len(prepared.names)
        if count >= MIN_POSED * total or found.numbers["turns_on_one_axis"]:
            return found
        fault = f"Only {count} of {count_noun(total, 'photo')} fit together."
    except StyleSplatError as error:
        fault = str(error)
    name = prepared.names[len(prepared.names) // 2]
    raise TurningNotPosed(fault, name, turntable.box(name))


def _drawn_on(masks: Path, prepared: PreparedPhotos) -> FoundMasks:
    """The user's masks, by the names that photos have in the capture."""
    origins = prepared.origins
    found = import_label_maps(masks, [origins[name] for name in prepared.names])
    return FoundMasks(
        {n: found.maps[own] for n, own in origins.items() if own in found.maps}, found.names
    )


def _cut_outs(source: Path, prepared: PreparedPhotos) -> FoundMasks:
    """What photos before a plain background show."""

    def drawn(own: str) -> DrawnLabels:
        path = resolve_within(source, own)
        return DrawnLabels(image_sizes(path)[1], partial(_object_in, path), own)

    return FoundMasks({n: drawn(own) for n, own in prepared.origins.items()}, CUT_OUT_NAMES)


def _object_in(path: Path) -> OwnLabels:
    return torch.from_numpy(cut_out_pixels(path)).int()


def _write_masks(capture: Capture, drawn: FoundMasks | None, folder: Path, output: Path) -> None:
    """Write masks as they are drawn, or of the object that turns; a line if there are none."""
    if drawn is not None:
        write_label_maps(with_drawn_maps(capture, drawn), folder)
    elif outlines := outline_moving_object(capture):
        maps = [
            partial(_enlarged, outline, camera.size)
            for outline, camera in zip(outlines, capture.cameras, strict=True)
        ]
        labelled = replace(capture, label_maps=Lazy(maps), object_names=CUT_OUT_NAMES)
        write_label_maps(labelled, folder)
    else:
        say(
            "No masks of what turns: the light or the camera changes too much between the photos "
            f"to cut it out. {fog_advice(output)}"
        )


def _enlarged(mask: Mask, size: tuple[int, int]) -> OwnLabels:
    smooth = cv2.resize(mask.numpy().astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return torch.from_numpy(smooth > 0.5).int()


def _shown(drawn: DrawnLabels) -> Bool[np.ndarray, "H W"]:
    return drawn.read().numpy() != BACKGROUND


def _place_box(box: Places, photos: Path, prepared: PreparedPhotos) -> tuple[str, PhotoBox]:
    """The name that the photo of a box has in the capture, and the box."""
    placed = BOX.parse_all(box, "box")
    if len(placed) != 1:
        raise StyleSplatError(f"There are {len(placed)} boxes. Draw one, in the clearest photo.")
    view, corners = placed[0]
    own = [prepared.origins[name] for name in prepared.names]
    if view in prepared.left_out:
        raise StyleSplatError(
            f"The photo {view} is left out: {prepared.left_out[view]}. Draw the box in another."
        )
    name = prepared.names[find_name(view, own)]
    return name, check_box(corners, image_sizes(resolve_within(photos, name))[1], view)


def _record(
    source: Path,
    digest: str,
    prepared: PreparedPhotos,
    found: Reconstruction,
    frame: Frame,
    config: SfmConfig,
    *,
    turns: bool,
) -> SfmRecord:
    origins = prepared.origins
    return SfmRecord(
        source=str(source.resolve()),
        digest=digest,
        given=len(prepared.names) + len(prepared.left_out),
        registered=len(prepared.names) - len(found.unregistered),
        left_out=_lines(prepared.left_out),
        unregistered=_lines({origins.get(n, n): why for n, why in found.unregistered.items()}),
        origins=_lines({name: own for name, own in origins.items() if name != own}),
        frame={
            "up": [0, -1, 0],
            "origin": "the centre of what the cameras look at",
            "unit": "the cameras' median distance from it",
            "from_colmap": {
                "scale": frame.scale,
                "rotation": frame.rotation.tolist(),
                "shift": None if frame.shift is None else frame.shift.tolist(),
            },
        },
        settings=asdict(config),
        numbers=dict(found.numbers),
        turns=turns,
        lenses=[
            TakenLens(
                camera.model_name,
                camera.width,
                camera.height,
                [*map(float, camera.params)],
                [each.name for each in posed_images(found.model) if each.camera_id == key],
            )
            for key, camera in found.model.cameras.items()
        ],
        libraries={
            "stylesplat": version("stylesplat"),
            "pycolmap": pycolmap.__version__,
            "av": av.__version__,
            "opencv": cv2.__version__,
        },
    )


def _checked(folder: Path, output: Path) -> CaptureReport:
    """Check the new capture, and write a picture of its cameras and points into it."""
    files = open_capture(folder)
    capture = files.at(files.whole.cameras.shrink_to(MEASURE_SIDE))
    report = check(capture)
    write_image(capture_picture(replace(capture, path=output), report), folder / SFM_PICTURE)
    return report


def _lines(texts: Mapping[str, str]) -> dict[str, str]:
    """The same texts, printable: names may hold any characters."""
    return {printable(name): printable(text) for name, text in texts.items()}
