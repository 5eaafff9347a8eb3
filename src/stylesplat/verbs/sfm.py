"""`sfm`: photos or a video in, a capture with poses out."""

import hashlib
import shutil
from dataclasses import asdict, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stylesplat.drawing.capture_picture import capture_picture
from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.io.captures.capture_folder import open_capture
from stylesplat.io.captures.sfm_file import SFM_FILE, SfmRecord, write_sfm
from stylesplat.io.folders import claim_directory, partial_of, refuse_occupied
from stylesplat.io.images import write_image
from stylesplat.io.recovery import changing
from stylesplat.posing.capture_report import CaptureReport
from stylesplat.posing.placing import place
from stylesplat.posing.prepare import prepare
from stylesplat.posing.prepared import Prepared
from stylesplat.posing.reconstruct import Reconstruction, reconstruct
from stylesplat.posing.sfm_config import SfmConfig
from stylesplat.posing.sharpness import SIDE
from stylesplat.posing.undistort import write_colmap
from stylesplat.progress import say
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import Frame
from stylesplat.verbs.check import advices, check
from stylesplat.verbs.load import load

PICTURE = "check.jpg"  # of cameras and points, in the capture
LISTED = 8  # photos that a line names
LIBRARIES = ("stylesplat", "pycolmap", "av", "opencv-python-headless")


def sfm(
    source: Path | str,
    output: Path | str,
    *,
    frames: int = 100,
    overwrite: bool = False,
    **settings: Any,
) -> Capture:
    """Find the cameras of photos or of a video, by structure from motion with COLMAP.

    Near-duplicates and very blurred photos are left out. The world gets a frame that people can
    work in: up is -y, the content is around the origin, and the median distance of the cameras
    from it is 1. What is done so far is kept in a folder beside `output`, from where an interrupted
    call goes on.

    Args:
        source: A folder of photos, sub-folders included, or a video.
        output: The folder of the capture to make: photos without distortion, poses and points in
            COLMAP's layout, and `sfm.json`, which says what became of each photo.
        frames: About how many frames of a video to take.
        overwrite: Whether `output` may hold an earlier result.
        settings: Fields of `SfmConfig` to change, such as `matching="sequential"`.

    Returns:
        The capture, as `load` reads it.

    Raises:
        StyleSplatError: If there are fewer than three photos that are fit for it, or their
            cameras cannot be found; it says why, and what would help.
        KeyboardInterrupt: After Ctrl-C, with what is done so far kept.

    Example:
        >>> import stylesplat as ss
        >>> capture = ss.sfm("MyPhotos/", "MyPhotos-capture/")  # doctest: +SKIP
    """
    for name in settings:
        check_choice(name, "setting", [field.name for field in fields(SfmConfig)])
    config, source, output = SfmConfig(**settings), Path(source), Path(output).resolve()
    refuse_occupied(output, marker=SFM_FILE, overwrite=overwrite)
    if output.is_relative_to(source.resolve()):
        raise StyleSplatError(f"{output} lies inside of {source}. Choose a folder outside of it.")
    partial = partial_of(output)
    photos = partial / "prepared"
    with changing(output):
        digest = digest_of(source)
        prepared = prepare(source, photos, frames=frames)
        found = reconstruct(photos, prepared, partial, config=config)
        frame = place(found.model)
        with claim_directory(output, overwrite=overwrite, marker=SFM_FILE) as new:
            write_colmap(found.model, photos, new)
            record = _record(source, digest, prepared, found, frame, config)
            write_sfm(record, new)
            report = _checked(new, output)
        shutil.rmtree(partial, ignore_errors=True)
    _say_result(record)
    for line in advices(report):
        say(line)
    return load(output)


def digest_of(source: Path) -> str:
    """What tells photos or a video from others: the names and sizes of the files, as SHA-256."""
    files = [source] if source.is_file() else sorted(source.rglob("*"))
    state = hashlib.sha256()
    for file in files:
        name = file.relative_to(source.parent if source.is_file() else source)
        if file.is_file() and not any(part.startswith(".") for part in name.parts):
            state.update(f"{name.as_posix()}\0{file.stat().st_size}\0".encode(errors="replace"))
    return state.hexdigest()


def _record(
    source: Path,
    digest: str,
    prepared: Prepared,
    found: Reconstruction,
    frame: Frame,
    config: SfmConfig,
) -> SfmRecord:
    origins = prepared.origins
    return SfmRecord(
        source=str(source.resolve()),
        digest=digest,
        given=len(prepared.names) + len(prepared.left_out),
        registered=len(prepared.names) - len(found.unregistered),
        left_out=dict(prepared.left_out),
        unregistered={origins.get(name, name): why for name, why in found.unregistered.items()},
        origins={name: own for name, own in origins.items() if name != own},
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
        libraries={name: version(name) for name in LIBRARIES},
    )


def _checked(folder: Path, output: Path) -> CaptureReport:
    """What a capture is like that is to be `output`; leaves the picture of it there."""
    files = open_capture(folder)
    capture = files.at(files.cameras.shrink_to(SIDE))
    report = check(capture)
    write_image(capture_picture(replace(capture, path=output), report), folder / PICTURE)
    return report


def _say_result(record: SfmRecord) -> None:
    """How many photos are posed, and which are not and why."""
    say(f"Posed {record.registered} of {record.given} photos.")
    for what, reasons in (("Left out", record.left_out), ("Not posed", record.unregistered)):
        for why in dict.fromkeys(reasons.values()):
            names = [name for name, other in reasons.items() if other == why]
            more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
            say(f"{what}: {', '.join(names[:LISTED])}{more}: {why}.")
