"""How training corrects label maps: the demo scene's corrupted ones in, its exact ones as truth.

    .venv/bin/python benchmarks/segmentation.py

Trains the demo's capture with the default preset and prints, per object and over the held-out
views, the IoU of the corrupted label maps and of those rendered from the identities (the claim of
the paper's figures 2 and 3). Targets: mean IoU of 0.95, every object clearly above its input.
"""

from dataclasses import dataclass

import torch
import tyro
from bench import OUT, machine, table

import stylesplat as ss
from stylesplat.demo.demo_capture import demo_capture
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.io.json_files import read_json
from stylesplat.metrics.iou import LabelPairs, object_iou
from stylesplat.scene.capture import Capture
from stylesplat.training.training_views import split_views


@dataclass(frozen=True)
class Options:
    """How to train."""

    seconds: float = 150
    """Training time."""
    max_gaussians: int = 50_000
    """Gaussians at most."""


def label_pairs(given: Capture, exact: Capture, rows: list[int]) -> LabelPairs:
    """The corrupted and the exact label map of each view."""
    assert given.label_maps is not None and exact.label_maps is not None
    for row in rows:
        corrupted, truth = given.label_maps[row], exact.label_maps[row]
        assert truth is not None
        yield (torch.zeros_like(truth) if corrupted is None else corrupted), truth


def main(options: Options) -> None:
    """Train and print the table."""
    folder = demo_capture(OUT / "demo")
    names = {int(id): name for id, name in read_json(folder / "object_names.json").items()}
    given, exact = ss.load(folder), ss.load(folder, masks=folder / "object_mask_exact")
    scene = ss.train(
        given, segment="joint", max_seconds=options.seconds, max_gaussians=options.max_gaussians
    )
    _, held_out = split_views(given, 8)
    pairs = list(label_pairs(given, exact, held_out))
    metrics = evaluate_views(scene.splats, exact, held_out)
    before, before_boundary = object_iou(pairs), object_iou(pairs, boundary=True)
    columns = before, metrics["iou"], before_boundary, metrics["boundary_iou"]
    rows = [
        [names.get(id, id), *(f"{column.get(id, 0):.3f}" for column in columns)]
        for id in metrics["iou"]
    ]
    means = (sum(column.values()) / len(column) for column in columns)
    rows.append(["mean", *(f"{mean:.3f}" for mean in means)])
    print(f"demo, {len(held_out)} held-out views, PSNR {metrics['psnr']:.2f} dB, {machine()}")
    print(table(["object", "IoU in", "IoU out", "boundary in", "boundary out"], rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
