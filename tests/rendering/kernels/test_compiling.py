import numba

from stylesplat.rendering.kernels.compiling import LINE, announce_compilation


def test_compilation_is_announced_once(capsys):
    announce_compilation.cache_clear()
    announce_compilation()
    announce_compilation()
    numba.njit(lambda x: x + 1)(1)
    numba.njit(lambda x: x + 2)(1)
    assert capsys.readouterr().err == f"{LINE}\n"
