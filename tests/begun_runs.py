"""Runs of training before their first step."""

import torch

from stylesplat.scene.capture import Capture
from stylesplat.training.initialize import first_splats, scene_extent
from stylesplat.training.per_photo import first_of_photos
from stylesplat.training.state import Run, State, first_state
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import training_views

CPU = torch.device("cpu")


def begun(
    capture: Capture, config: TrainConfig, batch: int = 1, *, of_photos: bool = False
) -> tuple[Run, State]:
    """On all photos, from a hundred Gaussians; with what is learned of photos, if it is wanted."""
    ids = (0, 3, 7) if capture.label_maps is not None else ()
    rows = range(len(capture))
    run = Run(
        config=config,
        rows=tuple(rows),
        views=training_views(capture, rows, ids=ids, device=CPU, max_memory=1.0),
        cameras=capture.cameras,
        extent=scene_extent(capture.cameras),
        device=CPU,
        batch=batch,
    )
    splats = first_splats(
        capture,
        sh_degree=3,
        max_gaussians=100,
        generator=torch.Generator().manual_seed(0),
        ids=ids,
    )
    state = first_state(splats)
    return run, state.with_photos(first_of_photos(run, capture.points)) if of_photos else state
