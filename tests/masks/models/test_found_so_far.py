from pathlib import Path

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.masks.models.found_so_far import open_progress


@pytest.mark.parametrize("left", [[], [".settings.0123456789ab.json"], ["labels_3.png", "x.json"]])
def test_a_folder_that_a_kill_left_without_settings(left: list[str], tmp_path: Path):
    """They are the first that is written, and may be the first that is deleted."""
    folder = tmp_path / "object_mask.partial"
    folder.mkdir()
    for name in left:
        (folder / name).touch()
    if "x.json" in left:
        with pytest.raises(StyleSplatError, match="in the way"):
            open_progress(folder, {})
        assert sorted(path.name for path in folder.iterdir()) == left
    else:
        open_progress(folder, {})
        assert [path.name for path in folder.iterdir()] == ["settings.json"]
