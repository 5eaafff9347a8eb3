"""The verbs as tools, called by the protocol's own client."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import anyio
import pytest

from stylesplat.cli.mcp import check_confined, mcp_server
from stylesplat.errors import StyleSplatError


def test_tools_over_stdio(scene: Path):
    """Another process serves; what is wrong is told, what is drawn comes as a picture."""
    pytest.importorskip("mcp")
    from mcp import Client, StdioServerParameters

    root = scene.parent
    words = ["-m", "stylesplat", "mcp", str(root)]
    server = StdioServerParameters(command=sys.executable, args=words, env={**os.environ})
    found = dict[str, Any]()

    async def talk() -> None:
        async with Client(server, read_timeout_seconds=120) as client:
            found["tools"] = (await client.list_tools()).tools
            for key, verb, words in (
                ("made", "recolor", ["scene", "--object", "3", "--hue", "90"]),
                ("wrong", "recolor", ["scene", "--object", "4", "--hue", "90"]),
                ("outside", "objects", ["../scene"]),
            ):
                found[key] = await client.call_tool(verb, {"arguments": words})

    anyio.run(talk)
    assert {"stylize", "recolor", "export"} <= {each.name for each in found["tools"]}
    answer, picture = found["made"].content
    assert json.loads(answer.text)["recolored"] == ["3"]
    assert picture.type == "image" and (root / "scene/layers.json").is_file()
    assert found["wrong"].is_error and "Object 4 does not exist" in found["wrong"].content[0].text
    assert found["outside"].is_error and "leads out of" in found["outside"].content[0].text


@pytest.mark.parametrize(
    "words",
    [
        ["/etc"],
        ["scene", "-o", "../out"],
        ["--style", "vase=/etc/passwd"],
        ["--style", "vase=a.jpg,../b.jpg"],
        ["~/scene"],
        ["link/scene"],
        ["--output=/tmp/x"],
        ["--recipe", "recipe.yaml"],
    ],
    ids=str,
)
def test_paths_stay_within_the_root(words: list[str], tmp_path: Path):
    (tmp_path / "link").symlink_to("/")
    check_confined(
        ["scene", "--style", "vase=a.jpg,sub/b.jpg", "--box", "v=1.jpg:0,0,9,9"], tmp_path
    )
    with pytest.raises(StyleSplatError):
        check_confined(words, tmp_path)


def test_a_root_that_is_not_there(tmp_path: Path):
    with pytest.raises(StyleSplatError, match="no folder"):
        mcp_server(tmp_path / "lost", {})
