from dataclasses import asdict, fields, replace

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.training.gradients import NEIGHBOR_EVERY, NEIGHBOR_SAMPLES, NEIGHBORS
from stylesplat.training.losses import DSSIM_WEIGHT, NEIGHBOR_WEIGHT
from stylesplat.training.schedule import means_decay
from stylesplat.training.step import rates
from stylesplat.training.train_config import PRESETS, SEGMENTS, TrainConfig


@pytest.mark.parametrize("name", ["steps", "max_gaussians", "refine_every", "sh_degree_every"])
@pytest.mark.parametrize("value", [0, -1])
def test_there_has_to_be_something_to_do(name: str, value: int):
    with pytest.raises(StyleSplatError, match=f"Cannot train with {name} {value}"):
        replace(TrainConfig(), **{name: value})


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_time_is_positive(value: float):
    with pytest.raises(StyleSplatError, match="max_seconds"):
        TrainConfig(max_seconds=value)


@pytest.mark.parametrize("value", [-0.1, float("nan")])
def test_memory_is_not_negative(value: float):
    assert TrainConfig(max_memory=0.0).max_memory == 0
    with pytest.raises(StyleSplatError, match="Cannot train with max_memory"):
        TrainConfig(max_memory=value)


def test_the_default_preset_is_the_default():
    assert PRESETS["default"] == TrainConfig()


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
    "object_pixels": (None, OURS),
    "refine_every": (100, f"{GAUSSIANS}: densification_interval"),
    "identity_every": (1, f"{GROUPING}: loss_obj in every iteration"),
    "identity_stride": (1, f"{GROUPING}: loss_obj, of every pixel"),
    "means_rate": (1.6e-4, f"{GAUSSIANS}: position_lr_init"),
    "bands_rate": (0.0025 / 20, "3D Gaussian splatting, gaussian_model.py: feature_lr / 20"),
    "classifier_rate": (5e-4, f"{GROUPING}: cls_optimizer"),
    "identity_geometry": (True, f"{GROUPING}: loss_obj reaches all tensors"),
    "color_correction": ("off", OURS),
    "refine_poses": (False, OURS),
    "photos_at_once": (1, f"{GROUPING}: one viewpoint_cam in every iteration"),
    "max_memory": (None, OURS),
}


def test_each_setting_of_the_paper_has_its_source():
    assert asdict(PRESETS["paper"]) == {name: value for name, (value, _) in PAPER.items()}
    assert SEGMENTS["paper"] == "joint", GROUPING


def test_the_rates_of_the_paper():
    extent = 3.0
    assert rates(PRESETS["paper"], extent) == pytest.approx(
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
    last = rates(PRESETS["paper"], extent * means_decay(1.0))
    assert last["means"] == pytest.approx(extent * 1.6e-6), "position_lr_final"


def test_the_losses_of_the_paper():
    assert DSSIM_WEIGHT == 0.2, f"{GAUSSIANS}: lambda_dssim"
    term = (NEIGHBOR_EVERY, NEIGHBORS, NEIGHBOR_SAMPLES, NEIGHBOR_WEIGHT)
    assert term == (5, 5, 1000, 2), "Gaussian Grouping, config/: reg3d_*"


def test_every_setting_says_what_it_is():
    # The command line makes its help of these.
    source = __import__("inspect").getsource(TrainConfig)
    for field in fields(TrainConfig):
        after = source.split(f"    {field.name}:")[1].splitlines()[1]
        assert after.strip().startswith('"""'), field.name
