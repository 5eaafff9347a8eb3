"""The verbs that look at scenes: what they take, and which function does the work.

Libraries are imported when a verb runs, so that `--help` answers at once.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from stylesplat.cli.options import Device, Json, Output, Overwrite


@dataclass(frozen=True)
class Objects:
    """List the objects of a scene and draw a contact sheet of them.

    Example: stylesplat objects garden-scene
    """

    scene: Positional[Path]
    """Folder of the scene; the sheet is written there as objects.png."""
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.objects import list_objects

        return list_objects(self.scene)


@dataclass(frozen=True)
class Render:
    """Render a scene into a folder of PNGs, or into a video.

    Example: stylesplat render garden-wave -o orbit.mp4 --views orbit
    """

    scene: Positional[Path]
    """Folder of the scene."""
    output: Output
    """Folder of pictures to make, or a file that ends in .mp4."""
    views: Literal["test", "train", "all", "orbit"] = "all"
    """Held-out views, training views, all of them, or a round trip."""
    what: str = "color"
    """color, labels (id maps), identities, depth, or object:NAME."""
    downscale: float = 1.0
    """How many times smaller than the photos."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.render import render_scene

        return render_scene(
            self.scene,
            self.output,
            views=self.views,
            what=self.what,
            downscale=self.downscale,
            device=self.device,
            overwrite=self.overwrite,
        )


@dataclass(frozen=True)
class Evaluate:
    """Measure a scene's held-out views: PSNR and SSIM, and IoU of the objects.

    Of a styled scene also what `stylize` measured: how close each object is to its style, what is
    left of it, whether views agree, and what changed around it.

    Example: stylesplat evaluate garden-scene --masks exact-masks
    """

    scene: Positional[Path]
    """Folder of the scene."""
    capture: Path | None = None
    """Folder of the photos; by default where they were when the scene was trained."""
    masks: Path | None = None
    """Folder of label maps to compare with; by default the capture's object_mask/."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.evaluate import evaluate_scene

        return evaluate_scene(
            self.scene, capture_path=self.capture, masks=self.masks, device=self.device
        )


@dataclass(frozen=True)
class Export:
    """Write a scene's splat for other programs.

    Example: stylesplat export garden-wave garden.spz
    """

    scene: Positional[Path]
    """Folder of the scene."""
    file: Positional[Path]
    """File to make: .ply keeps every bit, .spz and .splat are smaller."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.export import export
        from stylesplat.io.scene_folder import read_scene

        splats = read_scene(self.scene).splats
        export(splats, self.file, overwrite=self.overwrite)
        return {"file": self.file, "gaussians": len(splats)}


@dataclass(frozen=True)
class View:
    """Look at a scene in the browser.

    Example: stylesplat view garden-wave
    """

    scene: Positional[Path]
    """Folder of the scene."""
    port: int = 8080
    """Port on 127.0.0.1, or the next free one."""
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.drawing.browser import view
        from stylesplat.io.scene_folder import read_scene

        scene = read_scene(self.scene)
        view(scene.splats, cameras=scene.cameras, port=self.port)
        return {}
