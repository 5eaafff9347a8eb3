"""What changes in the course of training, as functions of what is done of the run."""

from stylesplat.training.train_config import TrainConfig

COARSE_UNTIL = ((0.12, 4), (0.35, 2))  # until this share of the run, photos this much smaller
MIN_SIZE = 64  # pixels; photos are not made smaller than this
SH_DEGREE_EVERY = 0.1  # share of the run per band, unless the settings give a number of steps
MEANS_DECAY = 0.01  # last learning rate of the means over the first (official)


def photo_downscale(progress: float, size: tuple[int, int], config: TrainConfig) -> int:
    """How many times smaller the photos are at this point of the run."""
    if config.coarse_to_fine:
        for until, factor in COARSE_UNTIL:
            if progress < until and min(size) >= factor * MIN_SIZE:
                return factor
    return 1


def sh_degree(progress: float, step: int, config: TrainConfig) -> int:
    """The degree of the spherical harmonics in use, after so many steps."""
    if config.sh_degree_every is not None:  # the official code raises it before the 1000th step
        return min(config.sh_degree, (step + 1) // config.sh_degree_every)
    return min(config.sh_degree, int(progress / SH_DEGREE_EVERY))


def means_decay(progress: float) -> float:
    """Factor on the learning rate of the means and on their noise."""
    return MEANS_DECAY**progress


def gaussian_count(progress: float, first: int, config: TrainConfig) -> int:
    """How many Gaussians there should be: exponential growth from the first count to the cap."""
    share = min(progress / config.growth_end, 1.0)
    return int(first * (max(config.max_gaussians, first) / first) ** share)
