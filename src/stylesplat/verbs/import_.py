"""`import`: a scene from a splat of another program, without training."""

import time
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, get_args

import torch
from jaxtyping import Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.evaluation.photos import evaluate_views, measured_rows
from stylesplat.io.gaussian_lists import read_objects
from stylesplat.io.splats.splat_files import declared_up, read_drawable
from stylesplat.masks.working_splat import CHECK_SIZE, FITTING_GAIN, frame_fits
from stylesplat.options import check_arguments
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device
from stylesplat.scene.capture import BACKGROUND, Capture, at_most
from stylesplat.scene.frames import (
    in_frame_of,
    known_frames,
    move_cameras,
    offset_of_frame,
    with_poses_of,
)
from stylesplat.scene.objects import ListedObjects, SceneObject, is_id
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.scene.splats import Splats
from stylesplat.scene.virtual_cameras import ring_cameras
from stylesplat.scene.world_offset import offset_text, place_text
from stylesplat.selection.labels import object_ids
from stylesplat.selection.objects import with_names
from stylesplat.selection.transfer import transfer_annotations
from stylesplat.training.lifting import labelled, lift

FrameName = Literal["capture", "nerfstudio", "nerfstudio-axes", "nerfstudio-colmap"]
Up = Literal["x", "-x", "y", "-y", "z", "-z"]
DEFAULT_UP = "-y"  # as COLMAP has it

WORKING_SIZE = 960  # pixels of the longer side at which labels are lifted and styles matched


@check_arguments
def import_(
    splat: Path | str | Splats,
    capture: Capture | None = None,
    *,
    frame: FrameName = "capture",
    up: Up | None = None,
    labels: Path | str | Int[Tensor, " N"] | None = None,
    like: Scene | None = None,
    device: str = "auto",
) -> Scene:
    """Make a scene of a splat, with the cameras and label maps of a capture if there is one.

    The splat stays as it is: same frame, same Gaussians, same order; those that cannot be drawn are
    left out, and a line says how many.

    Args:
        splat: A file that `read_splats` reads, such as a .ply, .spz, .sog, .glb or .usdz, a
            checkpoint of gsplat or splatfacto, a SOG folder's meta.json or a streamed SOG's
            lod-meta.json; or splats in memory.
        capture: The photos that it was made from. Without them the scene gets views around
            the content, most of which show all of it.
        frame: The world frame of the splat, if it differs from the capture's.
        up: The up direction of views without photos; by default what a comment of a .ply calls the
            vertical axis, as nerfstudio's does, or -y, as COLMAP has it.
        labels: The label id of every Gaussian of the splat's file, or a file of labels or objects;
            they replace the capture's label maps.
        like: The scene that another program made the splat of. Its views, objects and layers of
            paint are transferred (see `transfer_annotations`).
        device: Where to render.

    Returns:
        The scene. Its metrics are `seconds`, `gaussians`, and with photos `psnr` and `ssim`, with
        label maps `confidence` (mean share of a Gaussian's pixels that have its label),
        `unseen_gaussians`, and `miou` and `boundary_miou` against these same label maps; with
        labels `label_ids` and `unlabelled_gaussians`; with `like` those of
        `transfer_annotations`.

    Raises:
        StyleSplatError: If a file is damaged, the splat does not show what the photos do, or an
            option has no effect.
    """
    check_choice(frame, "frame", get_args(FrameName))
    if up is not None:
        check_choice(up, "direction", get_args(Up))
    if capture is None and frame != "capture":
        raise StyleSplatError("--frame needs the capture. Name its folder as well.")
    if capture is not None and up is not None:
        raise StyleSplatError("--up is for splats without photos. Leave it out.")
    if like is not None and (capture is not None or up is not None or labels is not None):
        raise StyleSplatError("--like has views and labels. Leave the capture, --up, --labels out.")
    start = time.perf_counter()
    file = None if isinstance(splat, Splats) else Path(splat)
    if isinstance(splat, Splats):
        splats, rows, count = splat, torch.arange(len(splat)), len(splat)
    else:
        splats, rows, count = read_drawable(splat)
    counts, listed = dict[str, int](), ListedObjects(len(splats))
    if labels is not None:
        by_row = isinstance(labels, Tensor)
        listed = ListedObjects(count, labels=labels) if by_row else read_objects(labels, count)
        if len(rows) < count and not (by_row and len(labels) != count):  # rows were left out
            listed = listed.ordered(rows)
        capture = capture and replace(capture, label_maps=None, object_names={})
    if listed.labels is not None:
        splats = labelled(splats, listed.labels)
        unlabelled = int((listed.labels == BACKGROUND).sum())
        counts = {"label_ids": len(object_ids(splats)), "unlabelled_gaussians": unlabelled}
    if like is not None:
        scene = transfer_annotations(splats, like, name=str(file or "The splat"))
    elif capture is None:
        axis = up or _declared_up(file) or DEFAULT_UP
        direction = torch.eye(3)["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
        scene = Scene(splats.to("cpu"), ring_cameras(splats, direction))
        say(
            f"No photos: {len(scene.cameras)} views around the content. `stylesplat render` shows "
            "them, `stylesplat mask` finds objects in them."
        )
    else:
        splats = splats.to(pick_device(device))
        splats = _placed(splats, str(file or "The splat"), at_most(capture, CHECK_SIZE), frame)
        scene = _with_photos(splats, capture, frame)
    for name, each in listed.objects.items():
        if not is_id(name):
            mask = torch.zeros(listed.count, dtype=torch.bool)
            mask[each.rows] = True
            scene = scene.with_object(name, SceneObject(mask, Selection(ids=each.ids)))
    libraries = {"stylesplat": version("stylesplat")}
    info = {**scene.info, "splat": file and file.resolve(), "libraries": libraries}
    seconds = round(time.perf_counter() - start, 2)
    metrics = {"gaussians": len(splats), **counts, **scene.metrics, "seconds": seconds}
    return replace(scene, info=info, metrics=metrics)


def _declared_up(file: Path | None) -> str | None:
    """The direction that a file calls up; a line names it if it is not the default."""
    up = None if file is None else declared_up(file)
    if up is not None and up != DEFAULT_UP:
        say(f"{file} says that {up} is up: its views stand so (`--up` says otherwise).")
    return up


def _with_photos(splats: Splats, capture: Capture, frame: FrameName) -> Scene:
    """The scene with cameras in the splat's frame, lifted labels, and PSNR of the photos."""
    cameras = move_cameras(capture.full_cameras, known_frames(capture.full_cameras)[frame])
    small = with_poses_of(at_most(capture, WORKING_SIZE), cameras)
    metrics: dict[str, Any] = {}
    if small.label_maps is None and splats.classifier is None:
        say("No label maps: objects can be picked by --box3d and --sphere only.")
    elif small.label_maps is not None:
        splats = lift(splats, small)
        assert splats.confidence is not None
        seen = splats.confidence[splats.confidence > 0]
        metrics["confidence"] = float(seen.mean())
        metrics["unseen_gaussians"] = len(splats) - len(seen)
    metrics |= evaluate_views(splats, small, measured_rows(small))
    scene = Scene(
        base=splats.to("cpu"),
        cameras=cameras,
        downscale=small.downscale,
        capture=capture.path and capture.path.resolve(),
        info={"settings": {"frame": frame}},
        metrics=metrics,
    )
    return with_names(scene, capture.object_names)


def _placed(splats: Splats, name: str, small: Capture, frame: FrameName) -> Splats:
    """The splats relative to the offset of their frame in the capture's world.

    Raises a StyleSplatError if renders do not match the photos; it names the frame that does.
    """
    frames = known_frames(small.cameras)
    placed = {
        each: in_frame_of(splats, offset_of_frame(each, small.world_offset)) for each in frames
    }

    def fit(each: str) -> float:
        return frame_fits(placed[each], small, {each: frames[each]})[each]

    own, gain = placed[frame], fit(frame)
    where = f" in {small.path}" if small.path else ""
    if gain > FITTING_GAIN:
        if own.means is splats.means and own.world_offset != splats.world_offset:
            say(
                f"{name} lies around the origin, but shows what the photos{where} do: it is taken "
                f"to be relative to {offset_text(own.world_offset)}."
            )
        return own
    gains = {each: fit(each) for each in frames if each != frame}
    best = max(gains, key=lambda each: gains[each])
    fault = (
        f"{name} does not show what the photos{where} do (renders are {gain:+.1f} dB "
        "from pictures of one colour)"
    )
    offsets = {splats.world_offset, small.world_offset}
    if len(offsets) > 1:
        here, there = (
            place_text(each.median(dim=0).values, offset)
            for each, offset in (
                (splats.means, splats.world_offset),
                (small.cameras.positions, small.world_offset),
            )
        )
        fault += f"; it lies around {here}, they were taken around {there}"
    if gains[best] > FITTING_GAIN:
        raise StyleSplatError(
            f"{fault}, but it does in the frame of another program. Pass --frame {best}."
        )
    raise StyleSplatError(
        f"{fault}. Give the capture that it was made from, or leave out the capture."
    )
