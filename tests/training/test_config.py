import math
import os
import subprocess
import sys
from dataclasses import asdict, replace
from typing import get_type_hints

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.training.config import (
    SEGMENTS,
    TRAIN_PRESETS,
    TrainConfig,
    means_decay,
)
from stylesplat.training.losses import DSSIM_WEIGHT, LOSS_MAX_POINTS, NEIGHBOR_WEIGHT
from stylesplat.training.step import (
    NEIGHBOR_EVERY,
    NEIGHBOR_SAMPLES,
    STEP_NEIGHBORS,
    learning_rates,
)

NAN = math.nan
WRONG = {
    **dict.fromkeys(("steps", "max_gaussians", "refine_every", "sh_degree_every"), (0, -1)),
    "max_seconds": (0.0, -1.0, NAN),
    "max_memory": (-1.0, NAN),
    "test_every": (-1,),
    "sh_degree": (-1, 4),
    "growth_end": (0.0, 1.5, NAN),
    "refine_end": (-0.1, 1.5),
    "object_growth": (-1.0, 0.0, math.inf),
    "scatter_weight": (-0.1, NAN),
    **dict.fromkeys(("means_rate", "bands_rate", "classifier_rate"), (-1e-3, NAN, math.inf)),
    "rate_factor": (-1e-3, NAN, math.inf),
    "cooldown": (-0.1, 1.5, NAN),
    "photos_at_once": (0,),
    "seed": (10**30,),
}


@pytest.mark.parametrize("name", WRONG)
def test_settings_out_of_range_are_refused(name: str):
    for value in WRONG[name]:
        with pytest.raises(StyleSplatError, match=f"Cannot train with {name} {value}"):
            replace(TrainConfig(), **{name: value})


KINDS_PROGRAM = """
from math import nan
import numpy as np
from stylesplat.errors import StyleSplatError
from stylesplat.training.config import TrainConfig
wrong = [(name, value) for name in COUNTS for value in (True, 1.5, "10", nan)]
wrong += [("growth_end", True), ("growth_end", None), ("growth_end", "1"), ("max_seconds", True)]
wrong += [("coarse_to_fine", 1), ("coarse_to_fine", None), ("color_correction", True)]
for name, value in wrong:
    try:
        TrainConfig(**{name: value})
        print(name, repr(value), "passed")
    except StyleSplatError as error:
        if f"Cannot train with {name} {value!r}: it must be" not in str(error):
            print(error)
TrainConfig(steps=np.int64(5), growth_end=np.float32(0.5), means_rate=0)
"""


def test_settings_of_other_kinds_are_refused():
    counts = [n for n, kind in get_type_hints(TrainConfig).items() if kind in (int, int | None)]
    assert "steps" in counts and "photos_at_once" in counts
    # On its own: in this process beartype checks the types before the code does
    program = KINDS_PROGRAM.replace("COUNTS", repr(counts))
    ended = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
    )
    assert (ended.returncode, ended.stdout) == (0, ""), ended.stderr


GAUSSIANS = "3D Gaussian splatting, arguments/__init__.py"
GROUPING = "Gaussian Grouping, train.py"
MCMC = "3DGS-MCMC, which stands for the densification of both"
OURS = "of neither: what is ours stays off"
PAPER = {
    "steps": (30_000, f"{GAUSSIANS}: iterations"),
    "max_seconds": (None, OURS),
    "max_gaussians": (1_000_000, f"{MCMC}: cap_max, 1,000,000 in gsplat"),
    "test_every": (8, "3D Gaussian splatting, scene/dataset_readers.py: llffhold"),
    "sh_degree": (3, f"{GAUSSIANS}: sh_degree"),
    "sh_degree_every": (1000, "3D Gaussian splatting, train.py: oneupSHdegree"),
    "seed": (0, "3D Gaussian splatting, utils/general_utils.py: safe_state"),
    "coarse_to_fine": (False, OURS),
    "growth_end": (0.5, f"{GAUSSIANS}: densify_until_iter 15,000 of 30,000"),
    "refine_end": (0.5, f"{GAUSSIANS}: densify_until_iter, which ends pruning too"),
    "object_growth": (1.0, OURS),
    "scatter_weight": (0.0, OURS),
    "refine_every": (100, f"{GAUSSIANS}: densification_interval"),
    "identity_every": (1, f"{GROUPING}: loss_obj in every iteration"),
    "identity_stride": (1, f"{GROUPING}: loss_obj, of every pixel"),
    "means_rate": (1.6e-4, f"{GAUSSIANS}: position_lr_init"),
    "rate_factor": (1.0, OURS),
    "cooldown": (0.0, OURS),
    "bands_rate": (0.0025 / 20, "3D Gaussian splatting, gaussian_model.py: feature_lr / 20"),
    "classifier_rate": (5e-4, f"{GROUPING}: cls_optimizer"),
    "identity_geometry": (True, f"{GROUPING}: loss_obj reaches all tensors"),
    "color_correction": ("off", OURS),
    "background": ("random", f"{GAUSSIANS}: random_background, which only cut-outs show"),
    "refine_poses": (False, OURS),
    "photos_at_once": (1, f"{GROUPING}: one viewpoint_cam in every iteration"),
    "max_memory": (None, OURS),
}


def test_each_setting_of_the_paper_has_its_source():
    assert asdict(TRAIN_PRESETS["paper"]) == {name: value for name, (value, _) in PAPER.items()}
    assert SEGMENTS["paper"] == "joint", GROUPING
    assert DSSIM_WEIGHT == 0.2, f"{GAUSSIANS}: lambda_dssim"
    term = (NEIGHBOR_EVERY, STEP_NEIGHBORS, NEIGHBOR_SAMPLES, NEIGHBOR_WEIGHT, LOSS_MAX_POINTS)
    assert term == (5, 5, 1000, 2, 200_000), "Gaussian Grouping, config/: reg3d_*"


def test_the_rates_of_the_paper():
    extent = 3.0
    assert learning_rates(TRAIN_PRESETS["paper"], extent, 0.0) == pytest.approx(
        {
            "means": extent * 1.6e-4,  # position_lr_init times spatial_lr_scale
            "sh0": 0.0025,  # feature_lr
            "shN": 0.0025 / 20,
            "opacities": 0.05,  # opacity_lr
            "scales": 0.005,  # scaling_lr
            "quats": 0.001,  # rotation_lr
            "identities": 0.0025,  # Gaussian Grouping: feature_lr, for obj_dc
            "weight": 5e-4,
            "bias": 5e-4,
        }
    )
    last = learning_rates(TRAIN_PRESETS["paper"], extent, 1.0)
    assert last["means"] == pytest.approx(extent * 1.6e-6), "position_lr_final"
    assert last["sh0"] == 0.0025, "only the rate of the means decays"


def test_rates_fall_to_0_in_the_last_part_of_a_run():
    config = TrainConfig(rate_factor=3.0, cooldown=0.25, bands_rate=0.01)
    rates = [learning_rates(config, 1.0, done) for done in (0.0, 0.75, 0.875, 1.0)]
    assert [each["opacities"] for each in rates] == pytest.approx([0.15, 0.15, 0.075, 0])
    assert [each["shN"] for each in rates] == pytest.approx([0.01, 0.01, 0.005, 0])
    assert rates[0]["identities"] == 0.0025 and rates[0]["weight"] == config.classifier_rate
    assert rates[2]["means"] == pytest.approx(config.means_rate * means_decay(0.875) / 2)


SHARES = [i / 100 for i in range(101)]
CONFIG = TrainConfig(max_gaussians=1000, growth_end=0.5)


def test_photos_grow_step_by_step_to_their_full_size():
    factors = [CONFIG.photo_downscale(p, (480, 360)) for p in SHARES]
    assert factors == sorted(factors, reverse=True)
    assert factors[0] == 4 and factors[-1] == 1 and set(factors) == {4, 2, 1}
    assert [CONFIG.photo_downscale(p, (480, 360)) for p in (0.0, 0.2, 0.5)] == [4, 2, 1]
    sizes = [(255, 999), (256, 256)]
    assert [CONFIG.photo_downscale(0.0, size) for size in sizes] == [2, 4], "64 pixels at least"
    assert replace(CONFIG, coarse_to_fine=False).photo_downscale(0.0, (480, 360)) == 1


def test_bands_are_added_one_by_one_up_to_the_degree():
    degrees = [replace(CONFIG, sh_degree=2).active_sh_degree(share, 0) for share in SHARES]
    assert degrees == sorted(degrees) and set(degrees) == {0, 1, 2}
    counted = replace(CONFIG, sh_degree_every=1000)  # whatever the length of the run
    degrees = [counted.active_sh_degree(0.5, step) for step in (0, 998, 999, 1999, 2999, 29_999)]
    assert degrees == [0, 0, 1, 2, 3, 3]


def test_gaussians_grow_from_the_first_to_the_cap():
    counts = [CONFIG.gaussian_count(p, 10) for p in SHARES]
    assert counts[0] == 10 and counts == sorted(counts)
    assert {count for p, count in zip(SHARES, counts, strict=True) if p >= 0.5} == {1000}
    assert max(counts) == 1000 and CONFIG.gaussian_count(0.25, 10) == 100, "exponentially"
