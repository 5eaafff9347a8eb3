"""Whatever computes on a GPU, scenes come back to the CPU; on any machine, see `fake_cuda.py`."""

from pathlib import Path

import pytest

from balls import GREEN, TRAINED, assert_same_splats, painted, write_pictures
from balls import PAINTED_FAST as FAST
from capture_files import write_ball_capture
from fake_cuda import cuda  # noqa: F401  (a fixture)
from stylesplat.scene.scene import Scene
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.load import load
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize
from stylesplat.verbs.stylize_live import stylize_live

pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture(scope="module")
def wave(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pictures(tmp_path_factory.mktemp("styles"))[0]


@pytest.fixture(scope="module")
def styled(wave: Path) -> Scene:
    """Painted on the CPU."""
    return painted(TRAINED, "red", wave, measured=False)


def test_what_stylize_paints_is_undone(cuda: str, wave: Path):  # noqa: F811
    styled = stylize(TRAINED, {"red": Style(wave, config=FAST)}, device=cuda)
    assert_same_splats(adjust(styled, undo=True).splats, TRAINED.splats)


def test_what_stylize_live_paints_is_painted_upon_and_undone(
    cuda: str,  # noqa: F811
    wave: Path,
    styled: Scene,
):
    scene = styled
    for name in ("green", "blue"):
        *_, live = stylize_live(scene, name, Style(wave, config=FAST), device=cuda)
        scene = live.scene()
    without = adjust(scene, objects=["green", "blue"], undo=True)
    assert_same_splats(without.splats, styled.splats)
    assert_same_splats(adjust(scene, undo=True).splats, TRAINED.splats)


def test_evaluate_measures_the_same(cuda: str, styled: Scene, tmp_path: Path):  # noqa: F811
    capture = load(write_ball_capture(tmp_path / "capture"))
    found = evaluate(styled, capture, device=cuda)
    expected = evaluate(styled, capture, device="cpu")
    assert found.keys() == expected.keys()
    assert found["psnr"] == pytest.approx(expected["psnr"], abs=0.1)
    assert found["nnfm_after"] == pytest.approx(expected["nnfm_after"], abs=0.01)


def test_select_takes_a_mask_of_either_device(cuda: str):  # noqa: F811
    found = select(TRAINED, "it", rows=GREEN.to(cuda)).objects["it"]
    assert found.picked.device.type == "cpu"
    assert found.picked.equal(GREEN)
