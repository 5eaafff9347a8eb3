from collections.abc import Iterator
from pathlib import Path

import pytest

from browser import session_in
from stylesplat.studio_app.session import Session


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    found = session_in(tmp_path)
    yield found
    found.worker.close()
