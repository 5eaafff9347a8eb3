"""`render`: pictures or a video of a scene."""

from pathlib import Path
from typing import Any, Literal

from stylesplat.drawing.orbit import orbit_cameras
from stylesplat.drawing.pictures import label_colors, render_pictures
from stylesplat.errors import StyleSplatError
from stylesplat.io.files import claim_directory
from stylesplat.io.images import write_image
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.scene_folder import Scene, read_scene
from stylesplat.io.video import write_video
from stylesplat.progress import track
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras

Which = Literal["test", "train", "all", "orbit"]
ORBIT_FRAMES = 180  # six seconds at 30 frames a second
VIDEO = ".mp4"


def render_scene(
    path: Path,
    output: Path,
    *,
    views: Which = "all",
    what: str = "color",
    downscale: float = 1.0,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Render views of a scene into a folder of PNGs, or into a video if `output` ends in .mp4.

    Returns:
        `output` and the number of `views`.

    Raises:
        StyleSplatError: If the scene has no such views or objects, or `output` is taken.
    """
    scene = read_scene(path)
    cameras = scene_views(scene, views).downscale(downscale)
    splats = scene.splats.to(pick_device(device))
    pictures = render_pictures(splats, cameras, what, picks=scene.picks)
    if output.suffix.lower() == VIDEO:
        if output.exists() and not overwrite:
            raise StyleSplatError(f"{output} exists. Choose another name, or pass --overwrite.")
        colors = label_colors if what == "labels" else lambda frame: frame
        write_video((colors(frame) for frame in track(pictures, "rendering")), output)
    else:
        write = write_label_map if what == "labels" else write_image
        with claim_directory(output, overwrite=overwrite, marker="") as folder:
            frames = track(pictures, "rendering")
            for name, frame in zip(cameras.names, frames, strict=True):
                write(frame, folder / f"{Path(name).stem}.png")
    return {"output": output, "views": len(cameras)}


def scene_views(scene: Scene, which: Which) -> Cameras:
    """The cameras of the held-out, training or all views, or of an orbit around the scene.

    Raises:
        StyleSplatError: If there are none.
    """
    if which == "orbit":
        return orbit_cameras(scene.cameras, ORBIT_FRAMES)
    held_out = set(scene.info.get("test_views", []))
    rows = [
        row
        for row, name in enumerate(scene.cameras.names)
        if which == "all" or (name in held_out) == (which == "test")
    ]
    if not rows:
        raise StyleSplatError(f"The scene has no {which} views. Choose --views all or orbit.")
    return scene.cameras[rows]
