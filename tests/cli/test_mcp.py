"""The verbs as tools, called by the protocol's own client."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import anyio
import pytest

from stylesplat.cli import VERBS
from stylesplat.cli.mcp import check_confined, mcp_server
from stylesplat.errors import StyleSplatError


def talk(server: Any, *calls: tuple[str, list[str]]) -> tuple[set[str], list[Any]]:
    """The names of a server's tools, and what it answers to calls."""
    from mcp import Client

    async def answers() -> tuple[set[str], list[Any]]:
        async with Client(server, read_timeout_seconds=120) as client:
            tools = {each.name for each in (await client.list_tools()).tools}
            return tools, [await client.call_tool(v, {"arguments": words}) for v, words in calls]

    return anyio.run(answers)


def test_a_process_serves_over_stdin_and_stdout(tmp_path: Path):
    mcp = pytest.importorskip("mcp")
    words = ["-m", "stylesplat", "mcp", str(tmp_path)]
    server = mcp.StdioServerParameters(command=sys.executable, args=words, env={**os.environ})
    tools, (outside,) = talk(server, ("objects", ["../scene"]))
    assert {"stylize", "recolor", "export"} <= tools and not {"studio", "mcp"} & tools
    assert outside.is_error and "leads out of" in outside.content[0].text


def test_what_is_drawn_comes_as_a_picture_and_what_is_wrong_is_told(scene: Path):
    pytest.importorskip("mcp")
    root = scene.parent
    _, (made, wrong) = talk(
        mcp_server(root, VERBS),
        ("recolor", ["scene", "--object", "3", "--hue", "90"]),
        ("recolor", ["scene", "--object", "4", "--hue", "90"]),
    )
    answer, picture = made.content
    assert json.loads(answer.text)["recolored"] == ["3"]
    assert picture.type == "image" and (root / "scene/layers.json").is_file()
    assert wrong.is_error and "Object 4 does not exist" in wrong.content[0].text


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        ("objects", ["/etc"]),
        ("objects", ["~/scene"]),
        ("objects", ["link/scene"]),
        ("objects", ["scene/../../scene"]),
        ("export", ["scene", "../out.ply"]),
        ("objects", ["scene", "-o", "../out.png"]),
        ("objects", ["scene", "-o../out.png"]),
        ("objects", ["scene", "-o/tmp/out.png"]),
        ("objects", ["scene", "-o=../out.png"]),
        ("objects", ["scene", "--output=/tmp/out.png"]),
        ("objects", ["scene", "--output", "link/out.png"]),
        ("stylize", ["scene", "-oout", "--style", "vase=/etc/passwd"]),
        ("stylize", ["scene", "-oout", "--style=vase=a.jpg,../b.jpg"]),
        ("stylize", ["scene", "-oout", "--style", "vase=a,link/b.jpg"]),
        ("stylize", ["scene", "-oout", "--recipe=recipe.yaml"]),
        ("select", ["scene", "--name", "vase", "--rows", "in.npz", "--rows", "link/rows.npz"]),
        ("evaluate", ["scene", "other", "../scene", "--compare", "-o", "page.html"]),
        ("mask", ["capture", "--from=../masks"]),
        ("objects", ["--tyro-write-completion", "bash", "out"]),
    ],
    ids=str,
)
def test_paths_stay_within_the_root(verb: str, words: list[str], tmp_path: Path):
    root = tmp_path / "root"
    root.mkdir()
    (root / "link").symlink_to(tmp_path)
    (root / "a,link").symlink_to(tmp_path)
    with pytest.raises(StyleSplatError):
        check_confined(VERBS[verb], words, root)


def test_usual_arguments_are_within_the_root(tmp_path: Path):
    style = ["scene", "-opainted", "--style", "vase=a.jpg,sub/b.jpg", "--style", "2=material:jade"]
    check_confined(VERBS["stylize"], style, tmp_path)
    check_confined(VERBS["select"], ["scene", "--name=a", "--box", "v/1.jpg:0,0,9,9"], tmp_path)
    check_confined(VERBS["objects"], [str(tmp_path / "scene"), "--json"], tmp_path)
    check_confined(VERBS["objects"], ["--help"], tmp_path)


def test_a_root_that_is_not_there(tmp_path: Path):
    with pytest.raises(StyleSplatError, match="no folder"):
        mcp_server(tmp_path / "lost", {})
