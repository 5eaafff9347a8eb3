import pytest


@pytest.fixture(autouse=True)
def kernels_run_in_parallel(all_cores: None) -> None:
    """As for users."""
