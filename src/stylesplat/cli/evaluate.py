"""`stylesplat evaluate`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import FlagCreatePairsOff, Positional, arg

from stylesplat.cli.next_steps import next_lines, unused
from stylesplat.cli.options import Device, Json, OptionalOutput, Overwrite, Verbose
from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import pasted

if TYPE_CHECKING:
    from stylesplat.scene.capture import Capture
    from stylesplat.scene.scene import Scene


@dataclass(frozen=True)
class Evaluate:
    """Measure a scene's held-out views: PSNR and SSIM, and IoU of the objects.

    Of a styled scene also what `stylize` measured: how close each object is to its style, what is
    left of it, whether views agree, and what changed around it.

    Example: stylesplat evaluate garden-scene --masks exact-masks
    """

    first: ClassVar = ("capture", "masks", "output", "compare")
    scene: Positional[Path]
    """Folder of the scene."""
    others: Positional[tuple[Path, ...]] = ()
    """Folders of scenes of the same photos, with --compare."""
    compare: Annotated[
        FlagCreatePairsOff[bool],
        arg(
            help="Put several scenes side by side on an HTML page, -o: the same views, the numbers "
            "of each, the differences to the first. The scenes stay as they are."
        ),
    ] = False
    capture: Path | None = None
    """Folder of the photos; by default where they were when the scene was trained, or where they
    were moved to together with it."""
    masks: Path | None = None
    """Folder of label maps to compare with; by default the capture's object_mask_exact/ if it has
    one, else its object_mask/."""
    output: OptionalOutput = None
    """JSON file to make of the numbers; without it the scene keeps them, in its metrics.json. With
    --compare the page to make."""
    overwrite: Overwrite = False
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.cli.side_by_side_page import refuse_wrong_mix, write_comparison
        from stylesplat.io.atomic import refuse_file, refuse_unwritable
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.evaluate import evaluate

        page = refuse_wrong_mix(self.others, self.output, compare=self.compare)
        if page is not None:
            paths = (self.scene, *self.others)
            refuse_file(page, overwrite=self.overwrite)
            return write_comparison(paths, page, self._capture, device=self.device)
        scene = open(self.scene)
        if self.output is None:
            refuse_unwritable(self.scene)
        else:
            refuse_file(self.output, overwrite=self.overwrite)
        metrics = evaluate(scene, self._capture(scene, self.scene), device=self.device)
        self._keep(metrics)
        return metrics

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        from stylesplat.cli.side_by_side_page import comparison_lines
        from stylesplat.evaluation.summary import photo_lines, style_lines

        if self.compare:
            yield from comparison_lines(result)
            return
        yield from photo_lines(result)
        if "changed_gaussians" in result:
            measured = [result.get(name, {}) for name in ("nnfm_after", "content_ssim")]
            yield from style_lines(result, {**measured[0], **measured[1]})
        video = unused(self.scene, ".mp4")
        yield from next_lines(pasted("render", self.scene, "-o", video, "--views", "orbit"))

    def _capture(self, scene: "Scene", path: Path) -> "Capture | None":
        """The photos of a scene, if they are there.

        Raises:
            StyleSplatError: If they are not, and there is nothing else to measure.
        """
        from stylesplat.io.captures.capture_folder import exact_masks
        from stylesplat.progress import say
        from stylesplat.verbs.load import load

        source = self.capture or scene.capture
        if source is None and not scene.layers:
            raise StyleSplatError(
                f"{path} knows no photos to compare with. Pass --capture with their folder."
            )
        gone = self.capture is None and source is not None and not source.is_dir()
        if gone and not scene.layers:
            raise StyleSplatError(
                f"The photos of {path} are no longer in {source}. Say with --capture where they "
                "are."
            )
        if gone:
            say(
                f"The photos are no longer in {source}, so only the style is measured. "
                "--capture says where they are."
            )
        if gone or source is None:
            return None
        return load(source, downscale=scene.downscale, masks=self.masks or exact_masks(source))

    def _keep(self, metrics: dict[str, Any]) -> None:
        from stylesplat.io.atomic import changing
        from stylesplat.io.json_files import write_json
        from stylesplat.io.scene_folder import open, revise

        with changing(self.output or self.scene):
            if self.output is not None:
                write_json(metrics, self.output)
                return
            latest = open(self.scene)  # measuring takes long
            measured = {**latest.metrics, "evaluate": metrics}
            revise(latest, replace(latest, metrics=measured), self.scene)
