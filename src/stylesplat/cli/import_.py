"""`stylesplat import`."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

import stylesplat as ss
from stylesplat.cli.options import Device, MakingCommand, Output
from stylesplat.cli.results import Answer, describe_scene, new_scene, pasted


@dataclass(frozen=True)
class Import(MakingCommand):
    """Make a scene of a splat that exists already, without training.

    Example: stylesplat import garden.ply garden -o garden-scene
    """

    splat: Positional[Path]
    """A .ply (also SuperSplat's compressed one), .spz, .splat, .ksplat, .sog, .glb or .gltf file,
    or the meta.json of a SOG folder."""
    output: Output
    """Folder of the scene to make."""
    capture: Positional[Path | None] = None
    """Folder with the posed photos that it was made from, and label maps in object_mask/. Without
    it the scene gets views around the content, which `mask` takes for photos."""
    up: Literal["x", "-x", "y", "-y", "z", "-z"] | None = None
    """The axis that points up, where there is no capture; by default what the file says, or -y."""
    frame: Literal["capture", "nerfstudio", "nerfstudio-axes", "nerfstudio-colmap"] = "capture"
    """World frame of the splat; an import that does not fit says which one does."""
    like: Path | None = None
    """Folder of the scene that another program made this splat of, by removing, adding, reordering
    or moving Gaussians: its views, objects and paintings are carried over."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    labels: Path | None = None
    """File of one label id per Gaussian, in the splat's order: .npy, .npz, or a .ply with
    the column label or object_id; or of objects, as `export` writes them. It takes the place of
    label maps."""
    device: Device = "auto"

    def run(self) -> Answer:
        if self.capture is None or self.labels is not None:
            self.refuse_given(("masks",), "no capture" if self.capture is None else "--labels")
        with new_scene(self.output, overwrite=self.overwrite) as save:
            capture = self.capture and ss.load(self.capture, masks=self.masks)
            scene = ss.import_(
                self.splat,
                capture,
                frame=self.frame,
                up=self.up,
                labels=self.labels,
                like=self.like and ss.open(self.like),
                device=self.device,
            )
            save(scene)
            photos = self.capture is not None or self.like is not None
            about = describe_scene(scene, capture, self.output, device=self.device, photos=photos)
        lines = [*self._lines(scene.metrics), *about.lines]
        return Answer({**scene.metrics, **about.values}, lines, about.following)

    def _lines(self, metrics: Mapping[str, Any]) -> Iterator[str]:
        close = f", {metrics['psnr']:.1f} dB from the photos" if "psnr" in metrics else ""
        yield f"{self.output}: {metrics['gaussians']:,} Gaussians{close}."
        if self.like is not None:
            yield (
                f"{metrics['matched']:,} of them are of {self.like}, {metrics['new_gaussians']:,} "
                f"are new; {metrics['lost_gaussians']:,} of its Gaussians are gone."
            )
            for part in metrics["moved"]:
                turn = f"turned by {part['degrees']:.4g} degrees, scaled by {part['scale']:.4g}"
                yield f"Moved: {part['gaussians']:,} Gaussians, {turn}."
        elif self.capture is None and self.up is None:
            from stylesplat.io.splats.splat_files import declared_up  # loads torch

            labels = ("--labels", self.labels) if self.labels else ()
            other = "-y" if declared_up(self.splat) == "z" else "z"
            again = pasted("import", self.splat, *labels, "-o", self.output, "--up", other)
            yield f"If it lies on its side: {again} --overwrite"
