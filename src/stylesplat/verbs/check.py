"""`check`: whether photos and poses will make a good scene, and what to do if not."""

from collections.abc import Collection

import torch

from stylesplat.argument_kinds import check_arguments
from stylesplat.io.captures.capture_folder import unposed_photos
from stylesplat.io.captures.colmap import ModelFigures, read_figures
from stylesplat.scene.capture import Capture
from stylesplat.structure_from_motion import diagnostics
from stylesplat.structure_from_motion.capture_statistics import measure_coverage, measure_photos
from stylesplat.structure_from_motion.diagnostics import CaptureReport, Finding
from stylesplat.structure_from_motion.world_frame import find_centre, working_frame


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
