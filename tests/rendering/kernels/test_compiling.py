from collections import defaultdict

import numba
from numba.core import event

from stylesplat.rendering.kernels.compiling import ONCE, announce_compilation


def test_compilation_is_announced_once(said: list[str], monkeypatch):
    # Other tests may have registered a listener that has not spoken yet.
    monkeypatch.setattr(event, "_registered", defaultdict(list))
    announce_compilation.cache_clear()
    announce_compilation()
    announce_compilation()
    numba.njit(lambda x: x + 1)(1)
    numba.njit(lambda x: x + 2)(1)
    assert said == [ONCE]
