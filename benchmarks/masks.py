"""Objects cut out of all photos from a box in one of them: how right, and how long it takes.

    .venv/bin/python benchmarks/masks.py

Through the verb `mask`, without any model: a quick splat of 3,000 steps, photos of 480 pixels. The
box is that of the object in one photo's label map, with a margin of 1 % of the photo's width.
Targets: a mean IoU of 0.90 in six other photos, evenly spread, for the fox as well as for the
bottle on the desk.
"""

import time
from dataclasses import dataclass
from statistics import mean

import torch
from bench import DATA, calibration_ms, capture, machine, table

import stylesplat as ss
from stylesplat.masks.grabcut import Box
from stylesplat.metrics.iou import mask_iou
from stylesplat.scene.capture import Capture
from stylesplat.scene.sampling import evenly

MARGIN = 0.01  # of a photo's width, between an object and its box
MEASURED = 6  # photos that the target is about


@dataclass(frozen=True)
class Case:
    """An object of a real scene."""

    scene: str
    row: int
    """Of the photo that the box is drawn in."""
    id: int
    """Of the object in the scene's label maps."""
    name: str


CASES = (Case("fox", row=10, id=1, name="fox"), Case("desk", row=0, id=1, name="bottle"))


def truth(real: Capture, case: Case, row: int) -> torch.Tensor | None:
    """The object's mask in a photo, if the photo has a label map."""
    labels = real.label_maps[row] if real.label_maps else None
    return None if labels is None else labels == case.id


def box(real: Capture, case: Case) -> Box:
    """Around the object in its photo."""
    mask = truth(real, case, case.row)
    assert mask is not None
    height, width = mask.shape
    y, x = (places.float() for places in mask.nonzero().T)
    margin = MARGIN * width
    left, top = max(0.0, float(x.min()) - margin), max(0.0, float(y.min()) - margin)
    right, bottom = float(x.max()) + 1 + margin, float(y.max()) + 1 + margin
    return left, top, min(float(width), right), min(float(height), bottom)


def measure(case: Case) -> tuple[dict[str, float], float, Box]:
    """IoU by photo, that with the box left out; the seconds it took; and the box."""
    real = capture(case.scene)
    drawn = box(real, case)
    photos = ss.load(DATA / case.scene, masks=False)
    start = time.perf_counter()
    boxes = {case.name: (photos.cameras.names[case.row], drawn)}
    found = ss.mask(photos, boxes=boxes, device="cpu").label_maps
    seconds = time.perf_counter() - start
    assert found is not None
    ious = {}
    for row, name in enumerate(photos.cameras.names):
        mask, labels = truth(real, case, row), found[row]
        if row != case.row and mask is not None and labels is not None and mask.any():
            ious[name] = mask_iou(labels == 1, mask)
    return ious, seconds, drawn


def main() -> None:
    """Print the numbers."""
    for case in CASES:
        capture(case.scene)  # exits where the data are absent
    print(f"{machine()}, calibration {calibration_ms():.0f} ms\n")
    summary, views = [], []
    for case in CASES:
        ious, seconds, drawn = measure(case)
        six = evenly([*ious], MEASURED)
        numbers = (mean(ious[name] for name in six), mean(ious.values()), min(ious.values()))
        place = ",".join(f"{side:.0f}" for side in drawn)
        summary.append([case.name, place, *(f"{n:.3f}" for n in numbers), f"{seconds:.0f}"])
        rows = [[name, f"{iou:.3f}", "yes" if name in six else ""] for name, iou in ious.items()]
        views.append(table([f"photo of {case.scene}", f"IoU of the {case.name}", "of six"], rows))
    six, others = f"mIoU in {MEASURED} photos", "in all others"
    print(table(["object", "box", six, others, "worst", "seconds"], summary), end="\n\n")
    print("\n\n".join(views))


if __name__ == "__main__":
    main()
