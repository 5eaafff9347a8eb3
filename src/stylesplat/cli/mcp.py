"""`stylesplat mcp`: the verbs as tools of the Model Context Protocol, over stdin and stdout."""

import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from inspect import getdoc
from pathlib import Path
from subprocess import DEVNULL
from threading import Thread
from typing import TYPE_CHECKING, Any, ClassVar

from tyro.conf import Positional

from stylesplat.cli.arguments import read_command
from stylesplat.cli.command import COMMAND_PICTURES, Answer, Command
from stylesplat.errors import StyleSplatError, shorten
from stylesplat.interrupts import wait_until

if TYPE_CHECKING:
    from mcp.server.mcpserver import MCPServer

MCP_LEFT_OUT = ("demo", "batch", "view", "studio", "mcp")  # they serve, or run files of commands
MCP_LONGER_SIDE = 1024  # pixels of a picture in an answer
MCP_MOST_PICTURES = 4  # in one answer
SEPARATORS = re.compile(r"[=,:]")  # between a name and a path in the value of an option


@dataclass(frozen=True)
class Mcp(Command):
    """Serve the verbs to an assistant as tools (Model Context Protocol), over stdin and stdout.

    Example: stylesplat mcp MyScenes
    """

    root: Positional[Path] = Path()
    """Folder that all paths have to lie in; relative ones start there."""
    serves: ClassVar[bool] = True

    def run(self) -> Answer:
        from stylesplat.cli import VERBS

        server = mcp_server(self.root, VERBS)
        thread = Thread(target=server.run, args=("stdio",), daemon=True)  # it reads stdin
        thread.start()
        wait_until(lambda seconds: thread.join(seconds) or not thread.is_alive())
        return Answer({})


def mcp_server(root: Path, verbs: Mapping[str, type]) -> "MCPServer":
    """A server with a tool for each verb, whose paths are confined to a folder."""
    try:
        from mcp.server.mcpserver import MCPServer
    except ImportError as error:
        raise StyleSplatError(
            "`stylesplat mcp` needs the extra: pip install 'stylesplat[mcp]'."
        ) from error
    if not root.is_dir():
        raise StyleSplatError(f"There is no folder {root}. Name the one that holds your scenes.")
    server = MCPServer("stylesplat", log_level="ERROR")
    for verb, command in verbs.items():
        if verb not in MCP_LEFT_OUT:
            about = f"{getdoc(command)}\n\nArguments are words of the command line after "
            about += f"`stylesplat {verb}`; ['--help'] explains them all."
            tool = _tool(verb, command, root.resolve())
            server.add_tool(tool, verb, description=about, structured_output=False)
    return server


def _tool(verb: str, kind: type, root: Path) -> Callable[..., Any]:
    from anyio import run_process
    from mcp.server.mcpserver import Image
    from mcp.server.mcpserver.exceptions import ToolError

    from stylesplat.io.images import jpeg_thumbnail

    async def tool(arguments: list[str]) -> list[Any]:
        words = [*arguments, "--json"]
        try:
            check_confined(kind, words, root)
        except StyleSplatError as error:
            raise ToolError(str(error)) from error
        command = [sys.executable, "-m", "stylesplat", verb, *words]
        done = await run_process(command, cwd=root, stdin=DEVNULL, check=False)
        answer = done.stdout.decode(errors="replace").strip()
        if done.returncode:
            raise ToolError(done.stderr.decode(errors="replace").strip()[-2000:])
        pictures = [*_pictures(answer, root)][:MCP_MOST_PICTURES]
        contents = (jpeg_thumbnail(each, MCP_LONGER_SIDE) for each in pictures)
        return [answer, *(Image(data=content, format="jpeg") for content in contents)]

    return tool


def check_confined(kind: type, words: list[str], root: Path) -> None:
    """Refuse words that make a command with a path outside of a folder, in whatever option."""
    if any(word.startswith("--tyro") for word in words):  # they write files while words are read
        raise StyleSplatError("--tyro options are not for tools. Leave them out.")
    try:
        command = read_command(kind, words, "", console_outputs=False)
    except SystemExit:  # help or wrong usage: the process that reads these words says so
        return
    if getattr(command, "recipe", None) is not None:  # it names paths of its own
        raise StyleSplatError("--recipe is not for tools. Pass its content as options.")
    for value in _values(vars(command)):
        for part in _possible_paths(value):
            if part.startswith("~") or not (root / part).resolve().is_relative_to(root):
                raise StyleSplatError(
                    f"{shorten(value)!r} leads out of {root}. Use paths within it."
                )


def _values(value: Any) -> Iterator[str]:
    """All texts and paths in the options of a command."""
    if isinstance(value, str | Path):
        yield str(value)
    elif isinstance(value, Mapping):
        yield from _values(value.values())
    elif isinstance(value, Iterable):
        for each in value:
            yield from _values(each)


def _possible_paths(value: str) -> Iterator[str]:
    """What verbs may take for a path in OBJECT=IMAGE,IMAGE; paths may contain separators."""
    yield from SEPARATORS.split(value)
    yield value
    yield from (value[found.end() :] for found in SEPARATORS.finditer(value))


def _pictures(answer: str, root: Path) -> Iterator[Path]:
    """The pictures that an answer names, and those of a folder that it names as its output."""
    try:
        values = json.loads(answer)
    except ValueError:  # help
        return
    for name, value in values.items() if isinstance(values, dict) else ():
        path = root / value if isinstance(value, str) and value else None
        if path is None or not path.resolve().is_relative_to(root):
            continue
        inside = sorted(path.rglob("*")) if name == "output" and path.is_dir() else [path]
        yield from (e for e in inside if e.suffix.lower() in COMMAND_PICTURES and e.is_file())
