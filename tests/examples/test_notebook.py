"""The notebook runs from top to bottom; other numbers take the place of its first cell's."""

import json
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

NOTEBOOK = Path(__file__).parents[2] / "examples" / "paint.ipynb"
TINY = {
    "TRAIN_STEPS": 20,
    "GAUSSIANS": 3000,
    "DOWNSCALE": 8.0,
    "PAINT": {"quality": "draft", "steps": 2, "object_size": 48},
}


@pytest.mark.usefixtures("quick_painting")
def test_it_runs_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tempfile.mkdtemp", lambda: str(tmp_path))
    names, shown = dict[str, Any](), []
    for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert not cell["outputs"] and cell["execution_count"] is None, "no results are committed"
        source = "".join(cell["source"])
        exec(source, names)
        if "parameters" in cell["metadata"].get("tags", []):
            assert names.keys() >= TINY.keys()
            names |= TINY
        last = source.splitlines()[-1]
        if last.startswith("picture("):
            shown.append(eval(last, names))
    assert len(shown) == 4 and all(isinstance(each, Image.Image) for each in shown)
    assert {"painted", "painted.html", "painted.ply"} <= {path.name for path in tmp_path.iterdir()}
