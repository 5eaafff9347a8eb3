"""Set-up of the tests of verbs."""

from collections.abc import Iterator

import pytest

from stylesplat.evaluation import style_metrics as report


@pytest.fixture(scope="module")
def small_measurements() -> Iterator[None]:
    """Painted objects are compared with their styles at a size that takes no time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "LENGTH", 30.0)
        yield
