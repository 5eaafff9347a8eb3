"""Pixels with transparency."""

import numpy as np

from stylesplat.io.images import flatten_alpha, straight_alpha


def test_colours_over_black_become_those_of_files_with_transparency():
    pixels = np.random.default_rng(0).integers(0, 256, (8, 8, 4)).astype(np.uint8)
    pixels[0, :, 3], pixels[1, :, 3] = 0, 255
    found = straight_alpha(flatten_alpha(pixels.copy(), 0))
    assert (found[1] == pixels[1]).all() and (found[..., 3] == pixels[..., 3]).all()
    assert (found[0, :, :3] == 255).all(), "nothing dark lies beside a rim"
    solid = pixels[..., 3] > 128
    assert np.abs(found[solid].astype(int) - pixels[solid]).max() <= 1
