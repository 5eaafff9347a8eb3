"""COLMAP in a process of its own, one stage at a time.

COLMAP ends its process when a disk is full, and some calls cannot be interrupted. So `run_stage`
starts a child process that runs `run_child`. The child gets its task on stdin, reports its progress
on stdout, and ends when its parent does, because that closes stdin. It does not load torch.
"""

import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from errno import ENOSPC
from pathlib import Path
from queue import Empty, SimpleQueue
from statistics import median
from typing import Any

import stylesplat
from stylesplat.errors import StyleSplatError
from stylesplat.interrupts import POLL_SECONDS, raise_if_interrupted
from stylesplat.io.files import cannot_write
from stylesplat.photo_libraries import pycolmap
from stylesplat.progress import Task, task
from stylesplat.structure_from_motion.config import MIN_PHOTOS

FATAL = 3  # log level: COLMAP logs nothing below what ends the process; errors are raised
# Items handed to COLMAP at once. Its threads wait for each other after each batch and the bar
# advances; smaller batches take longer, by a fifth and more
PHOTOS_PER_THREAD, PAIRS = 4, 50
# Features that suffice in a typical photo at its own size: fox (1250) then has poses within 0.05
# degrees, desk (440) has a fifth to a half more error than with the 1360 of twice the size
COLMAP_FEW = 800
FAINT = 0.002  # contrast of features on smooth objects; the usual third finds a fifth as many
LOG_LINES = 50  # of the child that are kept for error messages
COLMAP_DISK_FULL = re.compile(
    "disk is full|disk I/O error|No space left|File too large|quota exceeded", re.IGNORECASE
)
LOG_NOISE = re.compile(r"^(\s*@|\*\*\*|PC:|terminate called)")  # around the message of glog
LOG_PREFIX = re.compile(r"^(failed: |\s*what\(\):\s*|\[[\w.]+:\d+\] )+")


def run_stage(
    stage: str, settings: dict[str, Any], what: str, total: int, unit: str, done: int = 0
) -> None:
    """Run one of `COLMAP_STAGES` in a child process, with a progress bar.

    The child ends if this process ends or is interrupted. Its database stays valid: SQLite keeps
    a journal.
    """
    place = str(Path(stylesplat.__file__).parents[1])
    code = f"import sys; sys.path.insert(0, {place!r}); import {__name__} as colmap"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{code}; colmap.run_child()", stage],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        with suppress(BrokenPipeError):  # the child ended at once; its log says why
            process.stdin.write(json.dumps(settings | {"done": done}) + "\n")
            process.stdin.flush()
        with task(what, total, unit=unit, done=done) as bar:
            log = _follow(_polled(process.stdout), bar, total, done)
        status = process.wait()
    finally:
        process.kill()
        process.communicate()
    if status:
        if any(is_disk_full(line) for line in log):
            raise cannot_write(Path(settings["database"]), OSError(ENOSPC, ""))
        lines = (LOG_PREFIX.sub("", line) for line in log if not LOG_NOISE.match(line))
        fault = next(filter(None, lines), f"it ended with status {status}")
        raise StyleSplatError(f"{what}: COLMAP failed: {fault}. Run the same command again.")


def is_disk_full(text: str) -> bool:
    """Whether a message of COLMAP or SQLite says that the disk is full."""
    return bool(COLMAP_DISK_FULL.search(text))


def _polled(output: Iterable[str]) -> Iterator[str]:
    """The lines of a stream, which another thread reads, so that Ctrl-C ends the wait for them."""
    lines = SimpleQueue[str | None]()

    def read() -> None:
        for line in output:
            lines.put(line)
        lines.put(None)

    threading.Thread(target=read, daemon=True).start()
    while True:
        try:
            line = lines.get(timeout=POLL_SECONDS)
        except Empty:
            raise_if_interrupted()
            continue
        if line is None:
            return
        yield line


def _follow(output: Iterable[str], bar: Task, total: int, done: int) -> "deque[str]":
    """Advance the bar by the numbers that the child prints, and return its other lines."""
    log: deque[str] = deque(maxlen=LOG_LINES)
    for line in map(str.rstrip, output):
        if not line.isdecimal():
            log.append(line)
            continue
        now = min(int(line), total)  # several models may have the same photo
        bar.advance(max(0, now - done))
        done = max(done, now)
    return log


def run_child() -> None:
    """The child process: run the stage that the command line names."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: the parent decides
    task = json.loads(sys.stdin.readline())

    def end_with_parent() -> None:
        sys.stdin.read()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    try:
        run_in_process(sys.argv[1], task)
    except Exception as error:
        print(f"failed: {error}", flush=True)
        os._exit(1)


def run_in_process(stage: str, task: dict[str, Any]) -> None:
    """Run one of `COLMAP_STAGES` in this process; it prints how much is done."""
    pycolmap.logging.minloglevel = FATAL
    pycolmap.set_random_seed(task["seed"])
    COLMAP_STAGES[stage](task)


def _import_photos(task: dict[str, Any]) -> None:
    """Enter photos into the database, each group with one camera."""
    with pycolmap.Database.open(task["database"]):
        pass
    for group in task["groups"]:
        pycolmap.import_images(
            task["database"],
            task["photos"],
            pycolmap.CameraMode.SINGLE,
            image_names=group["names"],
            options=pycolmap.ImageReaderOptions(camera_model=group["model"]),
        )


def _extract_features(task: dict[str, Any]) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = task["max_size"]
    options.num_threads = task["threads"]
    options.sift.max_num_features = task["max_features"]
    reading = pycolmap.ImageReaderOptions(mask_path=task["masks"] or "")
    done, batch = task["done"], PHOTOS_PER_THREAD * task["threads"]
    for group in task["groups"]:
        _look_as_close_as_needed(task, group["sample"], options)
        for start in range(0, len(group["names"]), batch):
            names = group["names"][start : start + batch]
            pycolmap.extract_features(
                task["database"],
                task["photos"],
                names,
                reader_options=reading,
                extraction_options=options,
            )
            done += len(names)
            print(done, flush=True)


def _look_as_close_as_needed(
    task: dict[str, Any], sample: list[str], options: pycolmap.FeatureExtractionOptions
) -> None:
    """Set the first octave and the least contrast of features to the first that finds enough.

    Octave 0 is the photo's own size, -1 twice that, in four times as long. What is faint is looked
    for on an object alone.
    """
    usual = pycolmap.SiftExtractionOptions().peak_threshold
    closer = (
        [(0, usual)] * (not task["finest"]) + [(-1, usual)] + [(-1, FAINT)] * bool(task["masks"])
    )
    for options.sift.first_octave, options.sift.peak_threshold in closer:
        if (options.sift.first_octave, options.sift.peak_threshold) == closer[-1]:
            return
        counts = _feature_counts(task, sample, options)
        if counts and median(counts) >= COLMAP_FEW:
            return


def _feature_counts(
    task: dict[str, Any], sample: list[str], options: pycolmap.FeatureExtractionOptions
) -> list[int]:
    extractor = pycolmap.FeatureExtractor.create(options)
    counts = []
    for file in sample:
        bitmap = pycolmap.Bitmap.read(Path(task["photos"]) / file, as_rgb=False)
        if bitmap is None:
            continue
        shrink = min(1.0, task["max_size"] / max(bitmap.width, bitmap.height))
        bitmap.rescale(int(shrink * bitmap.width), int(shrink * bitmap.height))
        features = extractor.extract(bitmap)[0]
        if task["masks"]:
            mask = pycolmap.Bitmap.read(Path(task["masks"]) / f"{file}.png", as_rgb=False)
            assert mask is not None, "write_masks wrote it"
            mask.rescale(bitmap.width, bitmap.height)
            shown = mask.to_array() > 0
            counts.append(sum(bool(shown[int(each.y), int(each.x)]) for each in features))
        else:
            counts.append(len(features))
    return counts


def _match_pairs(task: dict[str, Any]) -> None:
    matching = pycolmap.FeatureMatchingOptions(num_threads=task["threads"])
    pairing = pycolmap.ImportedPairingOptions(match_list_path=task["list"])
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = task["seed"]
    verification.filter_stationary_matches = task["moves"]
    done = task["done"]
    for start in range(0, len(task["pairs"]), PAIRS):
        pairs = task["pairs"][start : start + PAIRS]
        lines = (f"{one} {other}\n" for one, other in pairs)
        Path(task["list"]).write_text("".join(lines), encoding="utf-8")
        pycolmap.match_image_pairs(task["database"], matching, pairing, verification)
        done += len(pairs)
        print(done, flush=True)


def _map_photos(task: dict[str, Any]) -> None:
    """Find poses and points, and write each model into a folder of its own.

    A task may say how many points are enough for a pose. Points that only two photos show, which
    COLMAP leaves out, then count as well.
    """
    options = pycolmap.IncrementalPipelineOptions()
    if "points" in task:
        options.mapper.abs_pose_min_num_inliers = task["points"]
        options.triangulation.ignore_two_view_tracks = False
    options.num_threads = task["threads"]
    options.random_seed = options.mapper.random_seed = task["seed"]
    options.triangulation.random_seed = task["seed"]
    options.min_model_size = MIN_PHOTOS  # photos of smaller groups count as not registered
    done = 0

    def registered(count: int = 1) -> None:
        nonlocal done
        done += count
        print(done, flush=True)

    Path(task["models"]).mkdir(parents=True, exist_ok=True)
    pycolmap.incremental_mapping(
        task["database"],
        task["photos"],
        task["models"],
        options,
        initial_image_pair_callback=lambda: registered(2),
        next_image_callback=registered,
    )


def _map_photos_at_once(task: dict[str, Any]) -> None:
    """The same by COLMAP's global mapper (Pan et al.: GLOMAP, 2024), from all pairs at once.

    Only pairs with so many matches count, if the task says how many.
    """
    options = pycolmap.GlobalPipelineOptions()
    options.min_num_matches = task.get("least", options.min_num_matches)
    options.num_threads, options.random_seed = task["threads"], task["seed"]
    options.min_model_size = MIN_PHOTOS
    Path(task["models"]).mkdir(parents=True, exist_ok=True)
    pycolmap.global_mapping(task["database"], task["photos"], task["models"], options)


COLMAP_STAGES: dict[str, Callable[[dict[str, Any]], None]] = {
    "import_photos": _import_photos,
    "extract_features": _extract_features,
    "match_pairs": _match_pairs,
    "map_photos": _map_photos,
    "map_photos_at_once": _map_photos_at_once,
}
