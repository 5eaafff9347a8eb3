"""The checks of a GPU, on the stand-in of one."""

import gpu
import pytest

from fake_cuda import cuda  # noqa: F401  (a fixture)


@pytest.mark.usefixtures("cuda")
def test_images_and_gradients_are_the_references(capsys: pytest.CaptureFixture[str]):
    assert gpu.check_correctness()
    assert capsys.readouterr().out.count("ok\n") == 8
