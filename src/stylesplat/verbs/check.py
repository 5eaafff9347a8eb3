"""`check`: whether photos and poses will make a good scene, and what to do if not."""

from collections.abc import Collection

import torch

from stylesplat.argument_kinds import check_arguments
from stylesplat.io.captures.capture_folder import unposed_photos
from stylesplat.io.captures.colmap import ModelFigures, read_figures
from stylesplat.scene.capture import Capture
from stylesplat.structure_from_motion import findings
from stylesplat.structure_from_motion.capture_report import CaptureReport
from stylesplat.structure_from_motion.centre import find_centre
from stylesplat.structure_from_motion.coverage import measure_coverage
from stylesplat.structure_from_motion.findings import Finding
from stylesplat.structure_from_motion.frame import working_frame
from stylesplat.structure_from_motion.photo_looks import photo_looks


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
    cameras, points = capture.cameras, capture.points
    frame = working_frame(cameras, torch.zeros(0, 3) if points is None else points)
    outward = find_centre(cameras, points).outward
    coverage = measure_coverage(cameras, points, frame, outward=outward)
    figures = None if capture.path is None else read_figures(capture.path)
    looks = photo_looks(capture)
    return CaptureReport(
        findings=(
            findings.on_count(len(capture)),
            *_on_reconstruction(capture, figures),
            findings.on_sides(coverage, len(capture)),
            findings.on_heights(coverage),
            findings.on_distances(coverage),
            *findings.on_looks(looks, cameras.names),
            findings.on_lenses(capture.full_cameras),
        ),
        blurred=tuple(cameras.names[row] for row in findings.blurred_rows(looks)),
        weak=tuple(findings.weakly_connected(figures.shared) if figures else ()),
        coverage=coverage,
        frame=frame,
    )


def advices(report: CaptureReport, *, known: Collection[str] = ()) -> list[str]:
    """What is not good and what to do about it, a line each, the worst first.

    Args:
        report: What `check` found.
        known: Findings of which the user knows the fact; their lines hold the advice alone.
    """
    lines = {
        verdict: [
            each.advice if each.what in known else each.line
            for each in report.findings
            if each.verdict == verdict
        ]
        for verdict in ("poor", "fair")
    }
    return [line[:1].upper() + line[1:] for line in lines["poor"] + lines["fair"]]


def _on_reconstruction(capture: Capture, figures: ModelFigures | None) -> list[Finding]:
    found = []
    if capture.path is not None:
        unposed, left_out = unposed_photos(capture.path, capture.cameras.names)
        found.append(findings.on_posed(len(capture), unposed, left_out))
    found += findings.on_model(figures) if figures else []
    points = capture.points
    return [*found, findings.on_points(0 if points is None else len(points))]
