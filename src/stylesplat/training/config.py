"""Settings of training, and what they say about each point of a run."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

from stylesplat.errors import StyleSplatError
from stylesplat.options import MANY, Config, Option, Seed

ColorCorrection = Literal["auto", "on", "off"]
Segment = Literal["joint", "lift"]
PhotoBackground = Literal["random", "black", "white"]

LEVELS = {"black": 0.0, "white": 1.0}  # of backgrounds that are not random
# Until this share of the run, photos this much smaller: steps there take a fraction of the time
COARSE_UNTIL = ((0.12, 4), (0.35, 2))
MIN_SIZE = 64  # pixels; photos are not made smaller than this
SH_DEGREE_EVERY = 0.1  # share of the run per band, unless the settings give a number of steps
MEANS_DECAY = 0.01  # last learning rate of the means over the first (official)

COUNT = Option(1, MANY, research=True)
RATE = Option(0, 10, research=True)
RESEARCH = Option(research=True)

IDENTITY_SETTINGS = (
    "object_growth",
    "identity_every",
    "identity_stride",
    "identity_geometry",
    "classifier_rate",
)
"""Settings that only `segment="joint"` uses."""


@dataclass(frozen=True)
class TrainConfig(Config):
    """How to train. Schedules that do not count steps are shares of the run: any length works."""

    verb: ClassVar = "train"
    steps: Annotated[int, Option(1, MANY)] = 5000
    """Optimiser steps, one photo each."""
    max_seconds: Annotated[float | None, Option(1e-6, MANY)] = None
    """Train for this long instead of for a number of steps."""
    max_gaussians: Annotated[int, Option(1, MANY)] = 100_000
    """The number of Gaussians grows up to here."""
    test_every: Annotated[int, Option(0, MANY)] = 8
    """Every this many photos one is held out to measure quality; 0 trains on all.

    By default the photos that the capture's files hold out, where they say which.
    """
    background: PhotoBackground = "random"
    """Colour behind transparent photos, and behind renders that are compared with them.

    Over a random colour at each step the splat stays transparent there; it is measured over black.
    Over black or white it may get that colour, and is measured over it.
    """
    color_correction: ColorCorrection = "auto"
    """Whether training learns each photo's exposure and white balance, apart from the splat.

    `auto` does where the capture's sparse points differ in brightness between photos, in the
    channel that differs most.
    """
    refine_poses: bool = False
    """Whether training refines the rotation and position of each training photo's camera.

    The mean over the photos stays where it was.
    """
    seed: Seed = 0
    """Seed of everything random; the same seed and thread count reproduce a run."""
    max_memory: Annotated[float | None, Option(0, MANY)] = None
    """GiB for decoded photos and label maps, by default 1; the others are read again each time."""
    photos_at_once: Annotated[int | None, COUNT] = None
    """Photos whose gradients are computed in parallel, before a step is taken for each.

    None: on the CPU one per thread, at most 4; on a GPU one. Several GPUs look at one photo each,
    and take one step for all of them.
    """
    sh_degree: Annotated[int, Option(0, 3, research=True)] = 3
    """Degree of the spherical harmonics, 0 to 3."""
    sh_degree_every: Annotated[int | None, COUNT] = None
    """Steps after which the degree in use grows by 1, from 0; None: a tenth of the run."""
    coarse_to_fine: Annotated[bool, RESEARCH] = True
    """Start on photos of a quarter, then half the size."""
    growth_end: Annotated[float, Option(0.001, 1, research=True)] = 0.4
    """Share of the run after which no Gaussians are added."""
    refine_end: Annotated[float, Option(0, 1, research=True)] = 0.9
    """Share of the run after which dead Gaussians are not moved either."""
    object_growth: Annotated[float, Option(0.001, 1000, research=True)] = 4.0
    """Densification prefers an object's Gaussians to the background's by this factor."""
    refine_every: Annotated[int, COUNT] = 100
    """Steps between moving dead Gaussians and adding new ones."""
    scatter_weight: Annotated[float, RATE] = 0.1
    """Weight of the loss that draws what a pixel mixes to one depth: surfaces instead of haze.

    It is in every second round from 0.4 of the run on, but for those that train identities.
    """
    identity_every: Annotated[int, COUNT] = 2
    """Identities are trained in every n-th round of photos that are computed together."""
    identity_stride: Annotated[int, COUNT] = 3
    """The identity loss samples every n-th pixel along x and y, from a random offset."""
    means_rate: Annotated[float, RATE] = 9.6e-4
    """First learning rate of the means, over the scene's extent.

    It falls to a hundredth in the course of the run, times what the cooldown leaves.
    """
    bands_rate: Annotated[float, RATE] = 1e-3
    """Learning rate of the higher colour bands."""
    rate_factor: Annotated[float, RATE] = 2.0
    """Factor on the learning rates of rotations, sizes, opacities and the constant band of colour.

    3DGS's, which are for runs of 30,000 steps, have the factor 1.
    """
    cooldown: Annotated[float, Option(0, 1, research=True)] = 0.2
    """Share of the run at its end over which the learning rates of Gaussians fall to 0."""
    classifier_rate: Annotated[float, RATE] = 2.5e-3
    """Learning rate of the classifier."""
    identity_geometry: Annotated[bool, RESEARCH] = False
    """Whether the identity loss may move and reshape Gaussians, as in Gaussian Grouping."""

    def progress(self, steps: int, seconds: float) -> float:
        """The share of the run that is done after these steps and seconds."""
        if self.max_seconds is not None:
            return min(seconds / self.max_seconds, 1.0)
        return min(steps / self.steps, 1.0)

    def photo_downscale(self, progress: float, size: tuple[int, int]) -> int:
        """How many times smaller the photos are at this point of the run."""
        if self.coarse_to_fine:
            for until, factor in COARSE_UNTIL:
                if progress < until and min(size) >= factor * MIN_SIZE:
                    return factor
        return 1

    def active_sh_degree(self, progress: float, step: int) -> int:
        """The degree of the spherical harmonics in use."""
        if self.sh_degree_every is not None:  # the official code raises it before the 1000th step
            return min(self.sh_degree, (step + 1) // self.sh_degree_every)
        return min(self.sh_degree, int(progress / SH_DEGREE_EVERY))

    def gaussian_count(self, progress: float, first: int) -> int:
        """Gaussians wanted: their number grows exponentially from the first count to the cap."""
        share = min(progress / self.growth_end, 1.0)
        return int(first * (max(self.max_gaussians, first) / first) ** share)


def means_decay(progress: float) -> float:
    """Factor on the learning rate of the means, beside the cooldown's, and on their noise."""
    return MEANS_DECAY**progress


TRAIN_PRESETS = {
    "default": TrainConfig(),
    "paper": replace(
        TrainConfig(),
        steps=30_000,
        max_gaussians=1_000_000,
        sh_degree_every=1000,
        coarse_to_fine=False,
        growth_end=0.5,
        refine_end=0.5,
        object_growth=1.0,
        scatter_weight=0.0,
        identity_every=1,
        identity_stride=1,
        means_rate=1.6e-4,
        bands_rate=1.25e-4,
        rate_factor=1.0,
        cooldown=0.0,
        classifier_rate=5e-4,
        identity_geometry=True,
        color_correction="off",
        photos_at_once=1,
    ),
}
"""Named settings: `paper` follows StyleSplat and Gaussian Grouping; a test names each source."""

SEGMENTS: dict[str, Segment] = {"default": "lift", "paper": "joint"}
"""How Gaussians come to their objects by each preset; `benchmarks/paper.py` compares the ways."""


def refuse_two_lengths(settings: Mapping[str, Any]) -> None:
    """Raise a StyleSplatError if a run is given a number of steps and a time, which replaces it."""
    steps, seconds = settings.get("steps"), settings.get("max_seconds")
    if steps is not None and seconds is not None:
        raise StyleSplatError(
            f"Cannot train with steps {steps} and max_seconds {seconds}: a run ends after either. "
            "Leave out one of them."
        )


def refuse_identity_settings(config: TrainConfig) -> None:
    """Raise a StyleSplatError if settings that lifting ignores differ from every preset's."""
    changed = [
        [name for name in IDENTITY_SETTINGS if getattr(config, name) != getattr(preset, name)]
        for preset in TRAIN_PRESETS.values()
    ]
    names = min(changed, key=len)
    if names:
        raise StyleSplatError(
            f"Cannot train with {', '.join(names)} and segment lift, which trains no identities: "
            "use segment joint, or leave out what it ignores."
        )
