"""Ids over all views: as single photos give them, tracked, and repaired in 3D.

    .venv/bin/python benchmarks/ids.py

No model takes part: the demo's exact label maps are spoilt as segmenters spoil them, by fragments,
merges, halves, ragged borders, and ids that are lost or swapped when they are followed. Shown are
the share of the objects' pixels with the one right id over all views, IDF1 of the objects found,
and how many ids there are for the demo's five objects. Ragged borders alone leave 0.976 of the
pixels right.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import torch
from bench import OUT, calibration_ms, machine, table
from faulty_segmenter import Mistakes, faulty_segmenter
from right_ids import right_ids

import stylesplat as ss
from stylesplat.demo.demo_capture import demo_capture
from stylesplat.demo.faults import FaultConfig
from stylesplat.masks.quick_splat import QUICK
from stylesplat.masks.repair import repair_ids
from stylesplat.masks.tracking import (
    Segmenter,
    TrackingState,
    masks_to_labels,
    split_clips,
    track_clip,
)
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import BACKGROUND, Labels
from stylesplat.training.loop import fit

SEEDS = range(4)
MISTAKES = {
    "mild": Mistakes(
        FaultConfig(missing=0.05, merged=0.08, fragments=0.15), halved=0.05, lost=0.03, swapped=0.03
    ),
    "usual": Mistakes(),
    "harsh": Mistakes(
        FaultConfig(border=6.0, missing=0.25, merged=0.35, fragments=0.5),
        halved=0.3,
        lost=0.25,
        swapped=0.25,
    ),
}


def tracked(capture: Capture, segmenter: Segmenter) -> list[Labels]:
    """Label maps of the whole capture."""
    state, maps = TrackingState(), dict[int, Labels]()
    for rows in split_clips(capture.cameras):
        found, state = track_clip(rows, state, segmenter)
        maps |= found
    return [maps[row] for row in range(len(capture))]


def scores(maps: Sequence[Labels], truth: Sequence[Labels]) -> list[str]:
    """Right pixels, IDF1 and the number of ids."""
    result = right_ids(maps, truth)
    ids = {id for labels in maps for id in labels.unique().tolist()} - {BACKGROUND}
    return [f"{result.right_pixels:.3f}", f"{result.idf1:.3f}", str(len(ids))]


def main() -> None:
    """Print the numbers."""
    print(f"{machine()}, calibration {calibration_ms():.0f} ms\n", flush=True)
    folder = demo_capture(OUT / "demo")
    capture = ss.load(folder, masks=folder / "object_mask_exact")
    assert capture.label_maps is not None
    truth = [labels for labels in capture.label_maps if labels is not None]
    plain = replace(capture, label_maps=None)
    splats = fit(plain, QUICK, device=torch.device("cpu")).splats.detach()
    lines = []
    for name, mistakes in MISTAKES.items():
        for seed in SEEDS if name == "usual" else SEEDS[:1]:
            segmenter = faulty_segmenter(truth, seed=seed, mistakes=mistakes)
            single = [
                masks_to_labels(dict(enumerate(segmenter.propose(row), start=1)), labels.shape)
                for row, labels in enumerate(truth)
            ]
            maps = tracked(capture, segmenter)
            start = time.perf_counter()
            repaired = repair_ids(splats, capture.cameras, maps)
            seconds = time.perf_counter() - start
            stages = (" / ".join(scores(each, truth)) for each in (single, maps, repaired))
            lines.append([name, seed, *stages, f"{seconds:.0f} s"])
    print("Right pixels / IDF1 / ids\n")
    heads = ["mistakes", "seed", "single photos", "tracked", "repaired", "repair takes"]
    print(table(heads, lines))


if __name__ == "__main__":
    main()
