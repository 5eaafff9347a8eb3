"""`stylesplat evaluate`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import Positional

from stylesplat.cli.next_steps import next_lines, pasted, unused
from stylesplat.cli.options import Device, Json, OptionalOutput, Overwrite, Verbose
from stylesplat.errors import StyleSplatError


@dataclass(frozen=True)
class Evaluate:
    """Measure a scene's held-out views: PSNR and SSIM, and IoU of the objects.

    Of a styled scene also what `stylize` measured: how close each object is to its style, what is
    left of it, whether views agree, and what changed around it.

    Example: stylesplat evaluate garden-scene --masks exact-masks
    """

    first: ClassVar = ("capture", "masks", "output")
    scene: Positional[Path]
    """Folder of the scene."""
    capture: Path | None = None
    """Folder of the photos; by default where they were when the scene was trained, or where they
    were moved to together with it."""
    masks: Path | None = None
    """Folder of label maps to compare with; by default the capture's object_mask_exact/ if it has
    one, else its object_mask/."""
    output: OptionalOutput = None
    """JSON file to make of the numbers; without it the scene keeps them, in its metrics.json."""
    overwrite: Overwrite = False
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.captures.capture_folder import exact_masks
        from stylesplat.io.places import refuse_file, refuse_unwritable
        from stylesplat.io.scene_folder import open
        from stylesplat.progress import say
        from stylesplat.verbs.evaluate import evaluate
        from stylesplat.verbs.load import load

        scene = open(self.scene)
        if self.output is None:
            refuse_unwritable(self.scene)
        else:
            refuse_file(self.output, overwrite=self.overwrite)
        source, capture = self.capture or scene.capture, None
        if source is None and scene.painted is None:
            raise StyleSplatError(
                f"{self.scene} knows no photos to compare with. Pass --capture with their folder."
            )
        gone = self.capture is None and source is not None and not source.is_dir()
        if gone and scene.painted is None:
            raise StyleSplatError(
                f"The photos of {self.scene} are no longer in {source}. "
                "Say with --capture where they are."
            )
        if gone:
            say(
                f"The photos are no longer in {source}, so only the style is measured. "
                "--capture says where they are."
            )
        elif source is not None:
            masks = self.masks or exact_masks(source)
            capture = load(source, downscale=scene.downscale, masks=masks)
        metrics = evaluate(scene, capture, device=self.device)
        self._keep(metrics)
        return metrics

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        from stylesplat.evaluation.in_words import photo_lines, style_lines

        yield from photo_lines(result)
        if "changed_gaussians" in result:
            measured = [result.get(name, {}) for name in ("nnfm_after", "content_ssim")]
            yield from style_lines(result, {**measured[0], **measured[1]})
        video = unused(self.scene, ".mp4")
        yield from next_lines(pasted("render", self.scene, "-o", video, "--views", "orbit"))

    def _keep(self, metrics: dict[str, Any]) -> None:
        from stylesplat.io.json_files import write_json
        from stylesplat.io.recovery import changing
        from stylesplat.io.scene_folder import open, revise

        with changing(self.output or self.scene):
            if self.output is not None:
                write_json(metrics, self.output)
                return
            latest = open(self.scene)  # measuring takes long
            measured = {**latest.metrics, "evaluate": metrics}
            revise(latest, replace(latest, metrics=measured), self.scene)
