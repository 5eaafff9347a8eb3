"""`stylesplat evaluate`: measure a scene, or compare several on a page."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tyro.conf import Positional

import stylesplat as ss
from stylesplat.cli.command import (
    Answer,
    Device,
    MakingCommand,
    OptionalOutput,
    SceneFolder,
    next_command,
)
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import locked_folder, refuse_file, refuse_unwritable, write_file
from stylesplat.io.json_yaml import write_json
from stylesplat.progress import say

COMPARISON_PAGE = ".html"
# Names of metrics, what lines call them, and how many digits they have there
COMPARISON_COMPARED = (("psnr", "PSNR", 2), ("ssim", "SSIM", 3), ("miou", "IoU", 3))
EXAMPLE = "`stylesplat evaluate A B --compare -o page.html`"


@dataclass(frozen=True)
class Evaluate(MakingCommand):
    """Measure a scene's held-out views: PSNR and SSIM, and IoU of the objects.

    For a styled scene also what `stylize` measured: how close each object is to its style, how much
    of it is kept, whether views agree, and what changed around it.

    Example: stylesplat evaluate garden-scene --masks exact-masks
    """

    scene: SceneFolder
    others: Positional[tuple[Path, ...]] = ()
    """Folders of scenes of the same photos, with --compare."""
    output: OptionalOutput = None
    """JSON file to make of the numbers; without it the scene keeps them, in its metrics.json. With
    --compare the page to make."""
    compare: bool = False
    """Compare several scenes on an HTML page, -o: the same views, the numbers of each, and the
    differences to the first. The scenes stay as they are."""
    capture: Path | None = None
    """Folder of the photos; by default where they were when the scene was trained, or where they
    were moved to together with it."""
    masks: Path | None = None
    """Folder of label maps to compare with; by default the capture's object_mask_exact/ if it has
    one, else its object_mask/."""
    device: Device = "auto"

    def run(self) -> Answer:
        from stylesplat.evaluation.summary import photo_lines, style_lines

        if self.compare:
            return self._compare()
        if self.others:
            raise StyleSplatError(
                f"Cannot evaluate {1 + len(self.others)} scenes at once. Compare them: {EXAMPLE}."
            )
        from stylesplat.io.scene_folder import revise

        scene = ss.open(self.scene)
        if self.output is None:
            refuse_unwritable(self.scene)
        else:
            refuse_file(self.output, overwrite=self.overwrite)
        capture = self._photos(scene, self.scene, required=not scene.layers)
        metrics = ss.evaluate(scene, capture, device=self.device)
        with locked_folder(self.output or self.scene):
            if self.output is not None:
                write_json(metrics, self.output)
            else:
                latest = ss.open(self.scene)  # measuring takes long
                measured = {**latest.metrics, "evaluate": metrics}
                revise(latest, replace(latest, metrics=measured), self.scene)
        lines = photo_lines(metrics)
        if lines and scene.layers:
            lines.append("The photos show the painted objects without their paint.")
        if "changed_gaussians" in metrics:
            measured = {**metrics.get("nnfm_after", {}), **metrics.get("content_ssim", {})}
            lines += style_lines(metrics, measured)
        return Answer(metrics, lines, [next_command("render", self.scene, "--views", "orbit")])

    def _photos(
        self, scene: "ss.Scene", path: Path, *, required: bool = False
    ) -> "ss.Capture | None":
        """The photos of a scene; None, after a line that says so, if they are gone."""
        from stylesplat.io.captures.capture_folder import exact_masks

        source = self.capture or scene.capture
        if source is not None and (self.capture or source.is_dir()):
            masks = self.masks or exact_masks(source)
            return ss.load(source, downscale=scene.downscale, masks=masks)
        gone = f"are no longer in {source}" if source else "are unknown"
        fact = f"The photos of {path} {gone}. Pass --capture with their folder."
        if required:
            raise StyleSplatError(fact)
        say(fact)
        return None

    def _compare(self) -> Answer:
        from stylesplat.figures.html_page import comparison_page
        from stylesplat.scene.scene import shared_views

        if not self.others:
            raise StyleSplatError(f"--compare needs at least two scenes, got one. Call {EXAMPLE}.")
        page = self.output
        if page is None or page.suffix.lower() != COMPARISON_PAGE:
            raise StyleSplatError(
                f"--compare makes an HTML page, got {page or 'none'} as its place. Pass -o with a "
                f"name in {COMPARISON_PAGE}."
            )
        refuse_file(page, overwrite=self.overwrite)
        given = (self.scene, *self.others)
        folders = {path.resolve().name: path for path in given}
        if len(folders) < len(given):
            folders = {str(path): path for path in given}
        scenes = {name: ss.open(folder) for name, folder in folders.items()}
        shared_views(scenes)  # raises before photos are read
        photos = {name: self._photos(scene, folders[name]) for name, scene in scenes.items()}
        captures = {name: each for name, each in photos.items() if each is not None}
        with locked_folder(page):
            found = ss.compare(scenes, captures, device=self.device)
            title = "Scenes compared"
            text = comparison_page(found.scenes, found.views, title=title, notes=found.notes)
            write_file(page, text)
        values = {**found.summary(), "page": page}
        about = f"Page: {page}, with all numbers and {len(found.views)} views of each."
        return Answer(values, [*map(_comparison_line, values["scenes"]), about])


def _comparison_line(scene: dict[str, Any]) -> str:
    metrics, differences = scene["metrics"], scene["differences"]
    parts = [
        f"{label} {metrics[name]:.{digits}f} ({differences.get(name, 0):+.{digits}f})"
        for name, label, digits in COMPARISON_COMPARED
        if name in metrics
    ]
    changed = 100 * scene["from_first"]["changed_share"]
    return f"{scene['name']}: {', '.join([*parts, f'{changed:.1f} % of its pixels differ'])}."
