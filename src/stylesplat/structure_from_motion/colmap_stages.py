"""The calls of pycolmap, one at a time, in a process of their own: `python -m` runs this file.

COLMAP ends its process when a disk is full, and some calls cannot be interrupted, so
`stylesplat.structure_from_motion.long_calls` runs it here. The process reports its progress on
stdout and ends with the process that started it, whose end of stdin it holds. It does not load
torch.
"""

import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.structure_from_motion.long_calls import FATAL
from stylesplat.structure_from_motion.prepared import LEAST

# What is handed to COLMAP at once, after which its threads wait for each other and the bar
# advances: less takes longer, by a fifth and more
PHOTOS = 4  # for each thread
PAIRS = 50
# Features in a typical photo at its own size: fox (1250) then has poses within 0.05 degrees, desk
# (440) has a fifth to a half more error than with the 1360 of twice the size
FEW = 800


def import_photos(task: dict[str, Any]) -> None:
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


def find_features(task: dict[str, Any]) -> None:
    """Find the features of photos, group by group."""
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = task["max_size"]
    options.num_threads = task["threads"]
    options.sift.max_num_features = task["max_features"]
    done, at_once = task["done"], PHOTOS * task["threads"]
    for group in task["groups"]:
        options.sift.first_octave = _first_octave(task, group["sample"], options)
        for start in range(0, len(group["names"]), at_once):
            names = group["names"][start : start + at_once]
            pycolmap.extract_features(
                task["database"], task["photos"], names, extraction_options=options
            )
            done += len(names)
            print(done, flush=True)


def _first_octave(
    task: dict[str, Any], sample: list[str], options: pycolmap.FeatureExtractionOptions
) -> int:
    """-1, which looks at photos twice as large and takes four times as long, or 0 if that does."""
    options.sift.first_octave = 0
    extractor = pycolmap.FeatureExtractor.create(options)
    counts = []
    for file in sample:
        bitmap = pycolmap.Bitmap.read(Path(task["photos"]) / file, as_rgb=False)
        if bitmap is None:
            continue
        shrink = min(1.0, task["max_size"] / max(bitmap.width, bitmap.height))
        bitmap.rescale(int(shrink * bitmap.width), int(shrink * bitmap.height))
        counts.append(len(extractor.extract(bitmap)[0]))
    return 0 if counts and median(counts) >= FEW else -1


def match_pairs(task: dict[str, Any]) -> None:
    """Compare pairs of photos."""
    matching = pycolmap.FeatureMatchingOptions(num_threads=task["threads"])
    pairing = pycolmap.ImportedPairingOptions(match_list_path=task["list"])
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = task["seed"]
    done = task["done"]
    for start in range(0, len(task["pairs"]), PAIRS):
        pairs = task["pairs"][start : start + PAIRS]
        lines = (f"{one} {other}\n" for one, other in pairs)
        Path(task["list"]).write_text("".join(lines), encoding="utf-8")
        pycolmap.match_image_pairs(task["database"], matching, pairing, verification)
        done += len(pairs)
        print(done, flush=True)


def map_photos(task: dict[str, Any]) -> None:
    """Find poses and points, and write each model into a folder of its own."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = task["threads"]
    options.random_seed = options.mapper.random_seed = task["seed"]
    options.triangulation.random_seed = task["seed"]
    options.min_model_size = LEAST  # smaller groups are said to be left out one by one
    done = 0

    def registered(amount: int = 1) -> None:
        nonlocal done
        done += amount
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


STAGES: dict[str, Callable[[dict[str, Any]], None]] = {
    stage.__name__: stage for stage in (import_photos, find_features, match_pairs, map_photos)
}


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


def main() -> None:
    """Run the stage that the command line names, with the task that stdin's first line holds."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: the parent decides
    task = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    pycolmap.logging.minloglevel = FATAL
    pycolmap.set_random_seed(task["seed"])
    try:
        STAGES[sys.argv[1]](task)
    except Exception as error:
        print(f"failed: {error}", flush=True)
        os._exit(1)


if __name__ == "__main__":
    main()
