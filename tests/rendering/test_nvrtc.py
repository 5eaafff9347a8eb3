"""Our CUDA kernels compile for GPUs from Turing on; NVRTC needs no GPU for that."""

from pathlib import Path

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.rendering import cuda, nvrtc
from stylesplat.training import adam, densification

DEFINES = {
    cuda.HARMONICS: cuda.SH_CONSTANTS,
    cuda.TILES: {"TILE": cuda.LARGE_TILE},
    cuda.BLEND: {"TILE": cuda.SMALL_TILE, "CHANNELS": cuda.PLANES},
    adam.KERNEL: {"ADAM_EPS": adam.EPS},
    densification.KERNEL: densification.NOISE_CONSTANTS,
}


@pytest.fixture(autouse=True)
def compiler() -> None:
    try:
        nvrtc.version()
    except StyleSplatError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("architecture", ["sm_75", "sm_86", "sm_90"])
def test_every_source_compiles(architecture: str):
    sources = [*nvrtc.FOLDER.glob("*.cu"), adam.KERNEL, densification.KERNEL]
    assert len(sources) == 6
    for source in sources:
        cubin = nvrtc.compile_source(source, architecture, **DEFINES.get(source, {}))
        assert cubin.startswith(b"\x7fELF")


def test_every_number_of_channels_and_every_tile_compiles():
    largest = {"TILE": cuda.LARGE_TILE, "CHANNELS": cuda.CHANNELS[-1]}
    for defines in (largest, {"TILE": cuda.SMALL_TILE, "CHANNELS": 1}):
        assert nvrtc.compile_source(cuda.BLEND, "sm_80", **defines)


def test_kernels_are_compiled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(name, str(tmp_path / "cache"))
    made = nvrtc.cached_cubin(adam.KERNEL, "sm_80", ADAM_EPS=adam.EPS)
    (file,) = (tmp_path / "cache").rglob("*.*")
    assert file.read_bytes() == made
    file.write_bytes(b"kept")
    assert nvrtc.cached_cubin(adam.KERNEL, "sm_80", ADAM_EPS=adam.EPS) == b"kept"
    assert nvrtc.cached_cubin(adam.KERNEL, "sm_80", ADAM_EPS=1.0) != b"kept"


def test_a_cache_that_cannot_be_written_to_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "file").touch()
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(name, str(tmp_path / "file"))
    assert nvrtc.cached_cubin(adam.KERNEL, "sm_80", ADAM_EPS=adam.EPS)


def test_the_error_is_the_compilers(tmp_path: Path):
    source = tmp_path / "broken.cu"
    source.write_text('extern "C" __global__ void broken() {\n    int i = nothing;\n}\n')
    with pytest.raises(StyleSplatError, match=r'broken\.cu\(2\): error: .*"nothing" is undefined'):
        nvrtc.compile_source(source, "sm_80")
    with pytest.raises(StyleSplatError, match="sm_1"):
        nvrtc.compile_source(adam.KERNEL, "sm_1", ADAM_EPS=adam.EPS)
