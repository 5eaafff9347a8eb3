"""`train`: posed photos in, a scene out."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.evaluation.photos import Fits, evaluate_views
from stylesplat.io.captures.capture_folder import OBJECT_MASK, read_sfm
from stylesplat.options import check_arguments, with_settings
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import scene_extent
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.selection.objects import with_names
from stylesplat.training.config import (
    SEGMENTS,
    TRAIN_PRESETS,
    PhotoBackground,
    Segment,
    TrainConfig,
    refuse_identity_settings,
    refuse_two_lengths,
)
from stylesplat.training.densification import without_hidden
from stylesplat.training.lifting import lift
from stylesplat.training.loop import fit, rank_and_processes
from stylesplat.training.object_alone import OBJECTS_ALONE, fog_advice, object_alone
from stylesplat.training.per_photo import with_refined_cameras
from stylesplat.training.views import learned_ids, split_views

TRAIN_COMPARED = 8  # photos trained on that are compared with their renders
TRAIN_LIBRARIES = ("stylesplat", "torch", "numba")


@check_arguments
def train(
    capture: Capture,
    config: TrainConfig | None = None,
    *,
    preset: str | None = None,
    segment: Segment | None = None,
    device: str = "auto",
    checkpoint: Path | None = None,
    finish: bool = False,
    **settings: Any,
) -> Scene:
    """Train a splat with objects from posed photos.

    Follows StyleSplat and Gaussian Grouping, with 3DGS-MCMC densification.

    Args:
        capture: Posed photos; with label maps if objects are wanted.
        config: How to train, in place of a preset.
        preset: `default`, or `paper` for 30,000 steps at the rates of the paper.
        segment: Whether Gaussians learn their objects along with their colours (`joint`), or the
            label maps are lifted onto them afterwards (`lift`, the default but for `paper`).
        device: `auto` takes an NVIDIA GPU where there is one.
        checkpoint: A file to continue from if it exists; written every minute and when
            interrupted, and left there.
        finish: Take no more steps: make a scene of what the checkpoint of an interrupted run has,
            however long that was to be.
        settings: Fields of `TrainConfig` to change, such as `steps=2000`. Those of identities and
            of objects' Gaussians need `joint`.

    Returns:
        The scene, its objects called what the capture calls them. Its metrics are `psnr` and
        `ssim` of the held-out views, `train_psnr` of some of the others, `seconds`, `steps`,
        `gaussians`, `steps_per_second`; of cut-outs also `object_psnr` and `train_object_psnr`,
        over the object alone. Where photos' colours or poses were learned, the views are
        measured half by half, each half fitted on the other (`psnr_unfitted` is without), and the
        splat has the typical photo's colours. With `refine_poses` the training views' cameras are
        the refined ones. Cameras and points that lie far from all others are left out.

    Raises:
        StyleSplatError: If the capture leaves nothing to train on, a setting is out of range, one
            of two (`config` and `preset`, `steps` and `max_seconds`) or `lift` would ignore one,
            there is no checkpoint to finish, or it is of other photos or settings.
        KeyboardInterrupt: After Ctrl-C, once the checkpoint is written.

    Example:
        >>> import stylesplat as ss
        >>> scene = ss.train(ss.load("garden/"), max_seconds=120)  # doctest: +SKIP
    """
    config, preset = _chosen(config, preset, settings)
    segment = segment or SEGMENTS[preset]
    check_choice(segment, "way to segment", get_args(Segment))
    if segment == "lift":
        refuse_identity_settings(config)
    if capture.label_maps is None:
        say("No label maps: training without identities, so objects cannot be selected by id.")
    torch_device = pick_device(device)
    capture = capture.without_outliers()
    record = None if capture.path is None else read_sfm(capture.path)
    turns = record is not None and record.turns
    alone = object_alone(capture, turns=turns)
    unmasked = capture.label_maps is None and capture.alphas is None
    if turns and unmasked and capture.path and not (capture.path / OBJECT_MASK).is_dir():
        say(f"The object turned in front of a room that stood still. {fog_advice(capture.path)}")
    if alone is not None:
        say("What is around the objects does not turn with them: they are trained alone.")
        capture = alone
    rows, held_out = split_views(capture, config.test_every)
    learned = capture if segment == "joint" else replace(capture, label_maps=None)
    state = fit(learned, config, device=torch_device, checkpoint=checkpoint, finish=finish)
    capture = with_refined_cameras(capture, state, rows)
    start = time.perf_counter()
    splats = without_hidden(state.splats.detach(), capture.cameras[rows])
    if segment == "lift" and capture.label_maps is not None:
        learned_ids(capture, rows)  # says which objects are not learned
        splats = _lifted(splats, capture, rows)
    seconds = state.seconds + time.perf_counter() - start
    fits = Fits(
        "color_maps" in state.params, "pose_shifts" in state.params, scene_extent(capture.cameras)
    )
    metrics = {}
    if held_out and rank_and_processes()[0] == 0:  # of processes that train together, one measures
        options = {"fits": fits, "background": config.background}
        metrics = evaluate_views(splats, capture, held_out, **options)
        metrics |= _train_metrics(splats, capture, rows, **options)
    scene = Scene(
        base=splats.to("cpu"),
        cameras=capture.full_cameras,
        held_out=tuple(capture.cameras.names[row] for row in held_out),
        downscale=capture.downscale,
        capture=capture.path and capture.path.resolve(),
        info={
            "settings": asdict(config) | {"segment": segment, "device": torch_device.type},
            "libraries": {name: version(name) for name in TRAIN_LIBRARIES},
        }
        | ({"fits": fits.names} if fits.names else {})
        | ({OBJECTS_ALONE: True} if alone else {}),
        metrics=metrics
        | {
            "seconds": round(seconds, 2),
            "steps": state.step,
            "gaussians": len(splats),
            "steps_per_second": round(state.step / max(state.seconds, 1e-9), 2),
        },
    )
    return with_names(scene, capture.object_names)


def _train_metrics(
    splats: Splats, capture: Capture, rows: Sequence[int], fits: Fits, background: PhotoBackground
) -> dict[str, float]:
    """PSNRs of some photos trained on, whose cameras are refined already."""
    unlabelled, fits = replace(splats, identities=None, classifier=None), replace(fits, pose=False)
    some = evenly_spaced(rows, TRAIN_COMPARED)
    found = evaluate_views(unlabelled, capture, some, fits=fits, background=background)
    names = found.keys() & {"psnr", "object_psnr"}
    return {f"train_{name}": found[name] for name in sorted(names)}


def _chosen(
    config: TrainConfig | None, preset: str | None, settings: Mapping[str, Any]
) -> tuple[TrainConfig, str]:
    """The config with the settings, and the preset whose way to segment goes with it."""
    if config is not None and preset is not None:
        raise StyleSplatError(
            f"Cannot train with preset {preset} and a config, which has all settings: leave out "
            "one of them."
        )
    preset = preset or "default"
    check_choice(preset, "preset", TRAIN_PRESETS)
    refuse_two_lengths(settings)
    return with_settings(config or TRAIN_PRESETS[preset], settings), preset


def _lifted(splats: Splats, capture: Capture, rows: Sequence[int]) -> Splats:
    """The splats with labels; without, if there is nothing to lift, for training took long."""
    try:
        return lift(splats, capture, rows=rows)
    except StyleSplatError as error:
        say(f"The scene knows no objects: {error}")
        return splats
