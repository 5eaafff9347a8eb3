"""Photos or a video in, poses out: how long, how right, and how well does it train?

    .venv/bin/python benchmarks/sfm.py                    # fox, desk and the video
    .venv/bin/python benchmarks/sfm.py many --views 300   # the time of many photos

Fox and desk: their photos alone, in a folder of their own. What comes out is aligned to the given
poses by the cameras' centres, then both captures are trained for as many steps on the same photos,
every 8th held out. The video goes once around the demo's still life, at uneven speed and with
blurred frames; it is compared with sharp stills from the true cameras of the frames that were
taken. Every side is measured on photos of its own: those of `sfm` are undistorted anew.
"""

import re
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Literal, NamedTuple

import torch
import tyro
from bench import DATA, OUT, calibration_ms, capture, machine, table
from orbit_video import FPS, is_shaky, stills, true_cameras, write_orbit
from pose_errors import pose_errors

import stylesplat as ss
from stylesplat.demo.still_life import dome_cameras, photograph
from stylesplat.io.captures.sfm_file import SfmRecord, read_sfm
from stylesplat.io.images import write_image
from stylesplat.progress import track
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture

Part = Literal["fox", "desk", "video", "many"]
DOWNSCALE = {"fox": 2.0, "desk": 2.0}  # for training
POSES = ["set", "time", "registered", "left out", "reprojection"]
POSES += ["median angle, degrees (worst)", "centre, % of the spread (worst)", "focal length"]
STAGES = ["set", "features", "compared", "matching", "mapping", "everything else"]
TRAINING = ["set", "size", "given or true poses", "poses found", "difference"]
TIME = re.compile(r"at ([\d.]+) s")  # of a frame, in what `sfm` calls it


@dataclass(frozen=True)
class Options:
    """What to pose."""

    what: Annotated[tuple[Part, ...], tyro.conf.Positional] = ("fox", "desk", "video")
    """Real scenes, the demo's video, or many photos of the demo."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Where to keep captures, outside of the project; by default they are deleted."""
    steps: int = 3000
    """Training steps of either side; 0 leaves training out."""
    frames: int = 100
    """How many frames of the video to take."""
    video_frames: int = 300
    """How many the video has."""
    views: int = 300
    """How many photos are many."""
    width: int = 480
    """Of the demo's photos, in pixels; the height is three quarters."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the demo's photos."""
        return self.width, self.width * 3 // 4


class Rows(NamedTuple):
    """Of the tables."""

    poses: list[object]
    stages: list[object]
    training: list[object] | None = None


@dataclass(frozen=True)
class Found:
    """What `sfm` made of photos."""

    name: str
    capture: Capture
    record: SfmRecord
    seconds: float

    @property
    def origins(self) -> list[str]:
        """What the user calls the photo of each camera."""
        names = self.capture.cameras.names
        return [self.record.origins.get(name, name) for name in names]


def posed(name: str, source: Path, folder: Path, *, frames: int = 100) -> Found:
    """Run `sfm` and keep the time."""
    start = perf_counter()
    found = ss.sfm(source, folder / f"{name}-capture", frames=frames)
    seconds = perf_counter() - start
    assert found.path is not None
    record = read_sfm(found.path)
    assert record is not None
    return Found(name, found, record, seconds)


def numbers(found: Found, given: Cameras) -> list[object]:
    """A row of the table of poses; `given` has a camera for each that was found, in order."""
    errors = pose_errors(found.capture.full_cameras, given)
    focal = found.capture.full_cameras.Ks[:, 0, 0] / given.Ks[:, 0, 0]
    record = found.record
    return [
        found.name,
        f"{found.seconds:.0f} s",
        f"{record.registered} of {record.given}",
        len(record.left_out),
        f"{record.numbers['reprojection_error']:.2f} px",
        f"{errors.degrees.median():.3f} ({errors.degrees.max():.2f})",
        f"{100 * errors.shares.median():.2f} ({100 * errors.shares.max():.1f})",
        f"{100 * (focal.median() - 1):+.2f} %",
    ]


def parts(found: Found) -> list[object]:
    """A row of the table of stages."""
    told = found.record.numbers
    photos, pairs, seconds = told["photos"], told["compared_pairs"], told["seconds"]
    return [
        found.name,
        f"{seconds['features'] / photos:.2f} s a photo",
        f"{pairs} pairs",
        f"{1e3 * seconds['matching'] / pairs:.0f} ms a pair",
        f"{seconds['mapping'] / photos:.2f} s a photo",
        f"{found.seconds - sum(seconds.values()):.0f} s",
    ]


def part(whole: Capture, rows: list[int]) -> Capture:
    """Some photos of a capture, without label maps."""
    photos = [whole.photos[row] for row in rows]
    return replace(
        whole, cameras=whole.cameras[rows], photos=photos, label_maps=None, alphas=None, full=None
    )


def trained(found: Found, given: Capture, steps: int) -> list[object]:
    """A row of the table of trainings, on the same photos of both captures in the same order."""
    qualities = []
    for each in (given, found.capture):
        metrics = ss.train(each, steps=steps).metrics
        qualities.append(metrics["psnr"])
    width, height = found.capture.cameras[0].size
    difference = qualities[1] - qualities[0]
    return [
        found.name,
        f"{width}x{height}",
        *(f"{quality:.2f} dB" for quality in qualities),
        f"{difference:+.2f} dB",
    ]


def real_scene(name: str, folder: Path, steps: int) -> Rows:
    """Pose a real scene's photos, and train on both poses."""
    given = capture(name)
    photos = folder / name
    shutil.copytree(DATA / name / "images", photos, dirs_exist_ok=True)
    found = posed(name, photos, folder)
    rows = [given.cameras.index(origin) for origin in found.origins]
    posing = numbers(found, given.cameras[rows]), parts(found)
    if steps == 0:
        return Rows(*posing)
    order = sorted(range(len(rows)), key=rows.__getitem__)
    assert found.capture.path is not None
    small = ss.load(found.capture.path, downscale=DOWNSCALE[name])
    mine = replace(found, capture=part(small, order))
    theirs = part(capture(name, DOWNSCALE[name]), sorted(rows))
    return Rows(*posing, trained(mine, theirs, steps))


def video(folder: Path, options: Options) -> Rows:
    """Pose frames of the demo's video, and train on them and on sharp stills."""
    (width, height), count = options.size, options.video_frames
    path = OUT / "sfm" / f"orbit_{width}x{height}_{count}.mp4"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_orbit(path, count, options.size)
    found = posed("video", path, folder, frames=options.frames)
    taken = [round(float(TIME.findall(origin)[-1]) * FPS) for origin in found.origins]
    blurred = sum(is_shaky(frame) for frame in taken)
    shaky = sum(is_shaky(frame) for frame in range(count))
    print(f"video: {len(taken)} frames, {blurred} of the {shaky} blurred ones among them")
    true = true_cameras(count, options.size)[taken]
    posing = numbers(found, true), parts(found)
    if options.steps == 0:
        return Rows(*posing)
    sharp = stills(replace(true, names=found.capture.cameras.names))
    return Rows(*posing, trained(found, sharp, options.steps))


def many(folder: Path, options: Options) -> Rows:
    """Pose many photos whose order is not known."""
    cameras = dome_cameras(options.views, *options.size)
    shuffled = torch.randperm(options.views, generator=torch.Generator().manual_seed(0)).tolist()
    photos = OUT / "sfm" / f"dome_{options.width}_{options.views}"
    names = [f"photo-{number:04d}.jpg" for number in shuffled]
    views = track(photograph(cameras, 0), "tracing photos", total=options.views)
    if not (photos / names[-1]).exists():
        for name, view in zip(names, views, strict=True):
            write_image(view.photo, photos / name)
    found = posed(f"{options.views} photos", photos, folder)
    true = cameras[[names.index(origin) for origin in found.origins]]
    return Rows(numbers(found, true), parts(found))


def report(folder: Path, options: Options) -> None:
    """Print the tables."""
    found, loops = [], [calibration_ms()]
    for what in options.what:
        if what == "many":
            found.append(many(folder, options))
        elif what == "video":
            found.append(video(folder, options))
        else:
            found.append(real_scene(what, folder, options.steps))
        loops.append(calibration_ms())
    print(f"\n{machine()}, calibration loop: {median(loops):.0f} ms\n")
    print(table(POSES, [rows.poses for rows in found]))
    print(f"\n{table(STAGES, [rows.stages for rows in found])}")
    trainings = [rows.training for rows in found if rows.training is not None]
    if trainings:
        print(f"\n{options.steps} steps, held-out PSNR\n\n{table(TRAINING, trainings)}")


def main(options: Options) -> None:
    """Pose in a folder that is kept, or in one that is not."""
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        report(options.output, options)
        return
    with tempfile.TemporaryDirectory() as folder:
        report(Path(folder), options)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
