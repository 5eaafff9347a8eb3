"""Whatever computes on a GPU, scenes come back to the CPU; on any machine, see `fake_cuda.py`."""

from pathlib import Path

import pytest

from balls import GREEN, TRAINED, assert_same_splats, opened
from balls import PAINTED_FAST as FAST
from capture_files import write_ball_capture
from fake_cuda import cuda  # noqa: F401  (a fixture)
from stylesplat.scene.scene import Scene
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.load import load
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize_live import stylize_live

pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture
def styled(stack: Path) -> Scene:
    """Painted on the CPU."""
    return opened(stack / "once")


def test_what_is_painted_upon_is_undone(cuda: str, stack: Path, styled: Scene):  # noqa: F811
    """`stylize` with a GPU is a part of the test of `doctor`."""
    style = Style(stack / "wave.png", config=FAST, quality="draft")
    *_, live = stylize_live(styled, "green", style, device=cuda)
    without = adjust(live.scene(), objects="green", undo=True)
    assert_same_splats(without.splats, styled.splats)
    assert_same_splats(adjust(live.scene(), undo=True).splats, TRAINED.splats)


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
