"""Masks of all photos from one box in one photo: how right are they, and where the object stands?

Boxes around the fox are judged by outlines drawn by hand; those around the demo's objects, the
desk's, the toy and the cape, each in the three views that show most, a middling part and little of
it, by label maps; and those around what turns on a turntable (`scripts/still_life/turntable.py`) by
its exact masks.
"""

import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import tyro
from bench import DATA, OUT, calibration_ms, capture_of, machine, table
from fox_outlines import FOX, outline_mask

import stylesplat as ss
from stylesplat.imaging.similarity import mask_iou
from stylesplat.io.captures.capture_folder import exact_masks
from stylesplat.io.label_maps import read_label_map
from stylesplat.masks.box_propagation import propagate_boxes, view_images
from stylesplat.masks.from_boxes import DRAWN_BOX_SIZE
from stylesplat.masks.grabcut import DrawnBox
from stylesplat.masks.working_splat import working_splat
from stylesplat.scene.capture import BACKGROUND, Capture, Mask, at_most, ids_of, resize_labels

MARGIN = 3  # pixels between an object and its box
LOWEST = 0.1  # of the object's height in a view
FEW = 20  # pixels of an object: a view with less is not judged
TURNED = 4  # boxes around what turns, in views all around


@dataclass(frozen=True)
class Drawn:
    """A box in one view, and the masks by which it is judged."""

    name: str
    row: int
    truth: Mapping[int, Mask]
    """By row of a view."""

    @property
    def box(self) -> DrawnBox:
        mask = self.truth[self.row]
        low, high = (edge.tolist() for edge in mask.nonzero().aminmax(dim=0))
        top, left = (max(0, edge - MARGIN) for edge in low)
        bottom, right = (
            min(edge + 1 + MARGIN, n) for edge, n in zip(high, mask.shape, strict=True)
        )
        return left, top, right, bottom


def of_fox(capture: Capture) -> list[Drawn]:
    cameras = capture.cameras
    rows = {name: cameras.index(name) for name in FOX}
    truth = {row: outline_mask(name, cameras[row].size, FOX) for name, row in rows.items()}
    return [Drawn("fox", row, truth) for row in truth]


def of_labels(name: str, capture: Capture) -> Iterator[Drawn]:
    views = {row: capture.labels(row) for row in range(len(capture))}
    maps = {row: labels for row, labels in views.items() if labels is not None}
    for id in sorted({id for labels in maps.values() for id in ids_of(labels)} - {BACKGROUND}):
        truth = {row: labels == id for row, labels in maps.items()}
        truth = {row: mask for row, mask in truth.items() if int(mask.sum()) > FEW}
        rows = sorted(truth, key=lambda row: -int(truth[row].sum()))
        for row in (rows[0], rows[len(rows) // 3], rows[2 * len(rows) // 3]):
            yield Drawn(f"{name} {id}", row, truth)


def of_turntable(capture: Capture, folder: Path) -> list[Drawn]:
    def mask(row: int) -> Mask:
        labels = read_label_map((folder / "masks" / capture.cameras.names[row]).with_suffix(".png"))
        return resize_labels(labels, capture.cameras[row].size[::-1]) != BACKGROUND

    truth = {row: mask(row) for row in range(len(capture))}
    truth = {row: each for row, each in truth.items() if int(each.sum()) > FEW}
    return [Drawn("turntable", [*truth][len(truth) * n // TURNED], truth) for n in range(TURNED)]


def lowest_iou(one: Mask, other: Mask) -> float:
    """IoU in the lowest tenth of the other mask."""
    rows = other.nonzero()[:, 0]
    first = int(rows.max() - LOWEST * (rows.max() - rows.min()))
    return mask_iou(one[first:], other[first:])


def judge(capture: Capture, drawn: list[Drawn]) -> Iterator[list[str]]:
    """Rows of the table."""
    working = working_splat(capture, None, "cpu")
    cameras = working.capture.cameras
    images = view_images(working.splats, working.capture)
    for each in drawn:
        start = time.process_time()
        masks = propagate_boxes(working.splats, cameras, images, [(each.row, each.box)])
        spent = time.process_time() - start
        pairs = [(masks[row], truth) for row, truth in each.truth.items()]
        ious, lowest = ([f(*pair) for pair in pairs] for f in (mask_iou, lowest_iou))
        means = [sum(some) / len(pairs) for some in (ious, lowest)]
        figures = f"{means[0]:.3f}", f"{min(ious):.3f}", f"{means[1]:.3f}", f"{spent:.1f}"
        yield [each.name, cameras.names[each.row], *figures]


def main(
    scenes: tuple[str, ...] = ("fox", "demo", "desk", "toy", "cape"), turntable: Path | None = None
) -> None:
    """Prints a row for each box.

    Args:
        scenes: Which to measure.
        turntable: What `scripts/still_life/turntable.py` wrote; none is not measured.
    """
    rows = list[list[str]]()
    path = OUT / "test_objects" / "demo" / "capture"
    for name in scenes:
        exact = name == "demo"
        found = ss.load(path, masks=exact_masks(path)) if exact else capture_of(DATA / name)
        found = at_most(found, DRAWN_BOX_SIZE)
        rows += judge(found, of_fox(found) if name == "fox" else [*of_labels(name, found)])
    if turntable is not None:
        first = next(iter(sorted((turntable / "photos").iterdir())))
        labels = read_label_map((turntable / "masks" / first.name).with_suffix(".png"))
        box = Drawn("turntable", 0, {0: labels != BACKGROUND}).box
        with tempfile.TemporaryDirectory() as folder:
            posed = ss.sfm(turntable / "photos", Path(folder) / "c", box=(first.name, *box))
            turned = at_most(posed, DRAWN_BOX_SIZE)
            rows += judge(turned, of_turntable(turned, turntable))
    print(f"{machine()}, calibration loop {calibration_ms():.0f} ms\n")
    columns = [
        "object",
        "view of the box",
        "mean IoU",
        "least",
        "lowest tenth",
        "processor seconds",
    ]
    print(table(columns, rows))


if __name__ == "__main__":
    tyro.cli(main)
