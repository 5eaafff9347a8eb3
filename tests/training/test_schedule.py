from itertools import pairwise

import pytest

from stylesplat.training.schedule import (
    COARSE_UNTIL,
    MEANS_DECAY,
    MIN_SIZE,
    gaussian_count,
    means_decay,
    photo_downscale,
    sh_degree,
)
from stylesplat.training.train_config import TrainConfig

SHARES = [i / 100 for i in range(101)]
CONFIG = TrainConfig(max_gaussians=1000, growth_end=0.5)


def test_photos_grow_step_by_step_to_their_full_size():
    factors = [photo_downscale(p, (480, 360), CONFIG) for p in SHARES]
    assert factors == sorted(factors, reverse=True)
    assert factors[0] == 4 and factors[-1] == 1 and set(factors) == {4, 2, 1}
    assert [photo_downscale(p, (480, 360), CONFIG) for p in (0.0, 0.2, 0.5)] == [4, 2, 1]


@pytest.mark.parametrize("size", [(64, 64), (100, 300), (130, 130), (256, 255), (256, 256)])
def test_photos_are_never_smaller_than_is_of_use(size: tuple[int, int]):
    for share in SHARES:
        factor = photo_downscale(share, size, CONFIG)
        assert factor == 1 or min(size) / factor >= MIN_SIZE
    assert photo_downscale(0.0, (256, 256), CONFIG) == 4


def test_photos_may_be_whole_from_the_start():
    plain = TrainConfig(coarse_to_fine=False)
    assert {photo_downscale(p, (4000, 3000), plain) for p in SHARES} == {1}


def test_coarse_stages_come_in_order():
    ends, factors = zip(*COARSE_UNTIL, strict=True)
    assert [*ends] == sorted(ends) and [*factors] == sorted(factors, reverse=True)
    assert ends[-1] < 1


@pytest.mark.parametrize("degree", range(4))
def test_bands_are_added_one_by_one_up_to_the_degree(degree: int):
    config = TrainConfig(sh_degree=degree)
    degrees = [sh_degree(p, 0, config) for p in SHARES]
    assert degrees[0] == 0 and degrees[-1] == degree
    assert degrees == sorted(degrees) and set(degrees) == set(range(degree + 1))


def test_bands_may_follow_the_steps_whatever_the_length_of_the_run():
    config = TrainConfig(sh_degree_every=1000)
    for share in SHARES:
        degrees = [sh_degree(share, step, config) for step in (0, 998, 999, 1999, 2999, 29_999)]
        assert degrees == [0, 0, 1, 2, 3, 3]


def test_rates_of_means_fall_to_a_hundredth():
    decays = [means_decay(p) for p in SHARES]
    assert decays[0] == 1 and decays[-1] == pytest.approx(MEANS_DECAY)
    assert all(one > other for one, other in pairwise(decays))


def test_rates_of_means_fall_by_equal_factors():
    assert means_decay(0.5) == pytest.approx(means_decay(0.2) * means_decay(0.3))


def test_gaussians_grow_from_the_first_to_the_cap():
    counts = [gaussian_count(p, 10, CONFIG) for p in SHARES]
    assert counts[0] == 10 and counts == sorted(counts)
    assert {count for p, count in zip(SHARES, counts, strict=True) if p >= 0.5} == {1000}
    assert max(counts) == 1000


def test_gaussians_grow_exponentially():
    assert [gaussian_count(p, 10, CONFIG) for p in (0.0, 0.25, 0.5, 1.0)] == [10, 100, 1000, 1000]


def test_more_first_gaussians_than_the_cap_stay_as_many():
    assert {gaussian_count(p, 2000, CONFIG) for p in SHARES} == {2000}
