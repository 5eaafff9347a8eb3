"""The vector layer computes what numpy computes."""

import numba
import numpy as np

from stylesplat.rendering.kernels import vec

RNG = np.random.default_rng(0)
NUMBERS = RNG.normal(size=64).astype(np.float32)
A, B = NUMBERS[:16], NUMBERS[16:32]


@numba.njit
def arithmetic(a, out):
    x, y = vec.load_vec(a, 0), vec.load_vec(a, 16)
    vec.store_vec(out, 0, vec.fma(x, y, x - y) / (y * y + 1.0))
    vec.store_vec(
        out, 16, vec.select(vec.greater(x, y), vec.minimum(x, 0.25), vec.maximum(y, -1.0))
    )
    vec.store_vec(out, 32, vec.fma(vec.rows(), 10.0, vec.columns() * 2.0))
    return vec.bits(vec.both(vec.greater_equal(x, y), vec.greater(x, np.float32(0))))


def test_arithmetic_and_masks():
    out = np.zeros(48, np.float32)
    mask = arithmetic(NUMBERS, out)
    assert np.allclose(out[:16], (A * B + A - B) / (B * B + 1), rtol=1e-5)
    assert np.array_equal(
        out[16:32], np.where(A > B, np.minimum(A, np.float32(0.25)), np.maximum(B, -1))
    )
    assert np.array_equal(out[32:], [2 * (i % 4) + 10 * (i // 4) for i in range(16)])
    assert mask == sum(1 << i for i in range(16) if A[i] >= B[i] and A[i] > 0)


@numba.njit
def exponential(a, out):
    for i in range(0, a.shape[0], 16):
        vec.store_vec(out, i, vec.exp_of_eighth(vec.load_vec(a, i)))


def test_exp_is_accurate_on_its_range():
    x = np.linspace(-0.7, 0, 4096, dtype=np.float32)
    out = np.empty_like(x)
    exponential(x, out)
    assert np.abs(out / np.exp(8 * x.astype(np.float64)) - 1).max() < 3e-6


@numba.njit
def lane_sums(a, out, channels):
    x, y = vec.load_vec(a, 0), vec.load_vec(a, 16)
    moments = vec.add_moments(vec.zeros((0,) * 6), vec.load_vec(a, 32), x, y)
    vec.add_lane_sums(out, 0, moments, vec.load_vecs(a, 0, channels))


def test_lane_sums_add_to_what_is_there():
    out = np.ones(32, np.float32)
    lane_sums(NUMBERS, out, (0,) * 4)
    lanes = NUMBERS.reshape(4, 16)
    moments = [lanes[2] * m for m in (1, A, B, A * A, A * B, B * B)]
    expected = 1 + np.concatenate([np.sum(moments, axis=1), lanes.sum(axis=1)])
    assert np.allclose(out[:10], expected, atol=1e-5)
    assert np.all(out[10:] == 1)


@numba.njit
def channel_products(a, row, out, channels):
    x = vec.load_vecs(a, 0, channels)
    vec.store_vec(out, 0, vec.dot_row(x, row, 1))
    grown = vec.add_scaled_row(vec.zeros(channels), vec.load_vec(a, 32), row, 0)
    vec.store_vecs(out, 16, vec.add_products(grown, vec.load_vec(a, 48), x))


def test_channel_products():
    row, out = np.array([0.5, 2, -3], np.float32), np.zeros(48, np.float32)
    channel_products(NUMBERS, row, out, (0,) * 2)
    assert np.allclose(out[:16], 2 * A - 3 * B, atol=1e-5)
    for i, x in enumerate((A, B)):
        expected = row[i] * NUMBERS[32:48] + NUMBERS[48:] * x
        assert np.allclose(out[16 + 16 * i : 32 + 16 * i], expected, atol=1e-5)


@numba.njit
def through_halves(a, halves, out):
    for i in range(0, a.shape[0], 16):
        vec.store_halves(halves, i, vec.load_vec(a, i))
        vec.store_vec(out, i, vec.load_halves(halves, i))


def test_halves_are_numpys():
    edges = [0, -0.0, 1, 1 / 3, 65504, 1e5, 1e-8, 6e-8, 1e-6, 2049, 2051, np.inf, -1 / 3, 6e-5]
    numbers = np.concatenate([NUMBERS, np.array([*edges, 1e-5, 0.999], np.float32)])
    halves, out = np.zeros(len(numbers), np.uint16), np.empty_like(numbers)
    through_halves(numbers, halves, out)
    with np.errstate(over="ignore"):
        expected = numbers.astype(np.float16)
    assert np.array_equal(halves, expected.view(np.uint16))
    assert np.array_equal(out, expected.astype(np.float32))
