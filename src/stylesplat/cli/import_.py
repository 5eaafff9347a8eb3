"""`stylesplat import`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from tyro.conf import Positional

from stylesplat.cli.next_steps import look_lines, next_lines, object_commands
from stylesplat.cli.options import Device, Json, Output, Overwrite, Verbose
from stylesplat.cli.results import save_or_rescue
from stylesplat.cli.scene_pictures import look
from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import pasted


@dataclass(frozen=True)
class Import:
    """Make a scene of a splat that exists already, without training.

    Example: stylesplat import garden.ply garden -o garden-scene
    """

    first: ClassVar = ("up", "frame", "like")
    splat: Positional[Path]
    """A .ply (also SuperSplat's compressed one), .spz, .splat, .sog, .glb or .gltf file, or
    the meta.json of a SOG folder."""
    output: Output
    """Folder of the scene to make."""
    capture: Positional[Path | None] = None
    """Folder with the posed photos that it was made from, and label maps in object_mask/. Without
    it the scene gets views around the content, which `mask` takes for photos."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    labels: Path | None = None
    """File of one label id per Gaussian, in the splat's order: .npy, .npz, .json, or a .ply with
    the column label or object_id; or of objects, as `export` writes them. It takes the place of
    label maps."""
    like: Path | None = None
    """Folder of the scene that another program made this splat of, by removing, adding, reordering
    or moving Gaussians: its views, objects and paintings are carried over."""
    frame: Literal["capture", "nerfstudio", "nerfstudio-axes", "nerfstudio-colmap"] = "capture"
    """World frame of the splat; an import that does not fit says which one does."""
    up: Literal["x", "-x", "y", "-y", "z", "-z"] | None = None
    """Which way is up, where there is no capture; -y by default."""
    device: Device = "auto"
    """Where to render; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.atomic import changing

        if self.capture is None and (self.masks is not None or self.frame != "capture"):
            raise StyleSplatError("--masks and --frame need the capture. Name its folder as well.")
        if self.labels is not None and self.masks is not None:
            raise StyleSplatError("--labels and --masks both say what is what. Pass one of them.")
        if self.like is not None and (self.capture is not None or self.labels is not None):
            raise StyleSplatError(
                "--like has views and labels. Leave the capture and --labels out."
            )
        with changing(self.output):
            return self._import()

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        close = f", {result['psnr']:.1f} dB from the photos" if "psnr" in result else ""
        yield f"{self.output}: {result['gaussians']:,} Gaussians{close}."
        yield from look_lines(result)
        if self.like is not None:
            yield from self._carried(result)
        photos = self.capture is not None or self.like is not None
        if not photos and self.up is None:
            labels = ("--labels", self.labels) if self.labels else ()
            again = pasted("import", self.splat, *labels, "-o", self.output, "--up", "z")
            yield f"If it lies on its side: {again} --overwrite"
        labelled = result["labelled"]
        commands = object_commands(self.output, result["objects"], labelled=labelled, photos=photos)
        yield from next_lines(*commands)

    def _carried(self, result: dict[str, Any]) -> Iterator[str]:
        """What became of the scene's Gaussians."""
        yield (
            f"{result['matched']:,} of them are of {self.like}, {result['new_gaussians']:,} are "
            f"new; {result['lost_gaussians']:,} of its Gaussians are gone."
        )
        for part in result["moved"]:
            turn = f"turned by {part['degrees']:.4g} degrees, scaled by {part['scale']:.4g}"
            yield f"Moved: {part['gaussians']:,} Gaussians, {turn}."

    def _import(self) -> dict[str, Any]:
        from stylesplat.io.atomic import refuse_occupied
        from stylesplat.io.kinds import SCENE
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.import_ import import_
        from stylesplat.verbs.load import load

        refuse_occupied(self.output, marker=SCENE, overwrite=self.overwrite)
        capture = None
        if self.capture is not None:
            capture = load(self.capture, masks=self.masks)
        scene = import_(
            self.splat,
            capture,
            frame=self.frame,
            up=self.up,
            labels=self.labels,
            like=self.like and open(self.like),
            device=self.device,
        )
        save_or_rescue(scene, self.output, overwrite=self.overwrite)
        return {**scene.metrics, **look(scene, capture, self.output, device=self.device)}
