"""The program `stylesplat`, a process of its own: its commands, progress and faults."""

import os
import re
import shutil
import subprocess
import threading
from collections.abc import Sequence
from pathlib import Path

PERCENT = re.compile(r"(\d+)%")
NAME = "stylesplat: "  # begins the line that says what is wrong


class ProgramError(Exception):
    """What is wrong, in one line."""


def find_program(name: str) -> str:
    """The path of the program.

    Raises:
        ProgramError: If there is none.
    """
    path = shutil.which(Path(name).expanduser())
    if path is None:
        raise ProgramError(
            f"There is no program {name!r} on the PATH. Run `pip install stylesplat`, or say where "
            "it is in the preferences of the extension."
        )
    return path


class Job:
    """Commands that run one after the other."""

    def __init__(self, program: str, commands: Sequence[Sequence[object]]) -> None:
        self.commands = [[program, *map(str, command)] for command in commands]
        self.done, self.share, self.line = 0, 0.0, "starting"
        self._process: subprocess.Popen[str] | None = None
        self._fault = self._last = ""
        self._start()

    def _start(self) -> None:
        environment = {n: v for n, v in os.environ.items() if not n.startswith("PYTHON")}
        self._process = subprocess.Popen(
            self.commands[self.done],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )
        self._reader = threading.Thread(target=self._read, args=(self._process,), daemon=True)
        self._reader.start()

    def _read(self, process: "subprocess.Popen[str]") -> None:
        assert process.stderr is not None
        for line in process.stderr:
            if found := PERCENT.search(line):
                self.share, self.line = int(found[1]) / 100, line.split(":")[0]
            self._last = line.strip() or self._last
            if line.startswith(NAME):
                self._fault = self._last.removeprefix(NAME)

    @property
    def progress(self) -> float:
        """0 to 1."""
        return min((self.done + self.share) / len(self.commands), 1.0)

    def poll(self) -> bool:
        """Go on; returns whether all commands are done.

        Raises:
            ProgramError: If one failed.
        """
        if self._process is None or self._process.poll() is None:
            return self._process is None
        self._reader.join()
        if self._process.returncode:
            code = self._process.returncode
            ended = f"stylesplat ended with the exit status {code}: {self._last}"
            raise ProgramError(self._fault or ended)
        self.done, self.share = self.done + 1, 0.0
        if self.done == len(self.commands):
            self._process = None
            return True
        self._start()
        return False

    def cancel(self) -> None:
        """End the process, which leaves nothing half written."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()


def paint_commands(
    folder: Path, up: str, picture: str, settings: dict[str, object]
) -> list[list[object]]:
    """From in.ply and rows.npy of a folder to out.ply."""
    options = [word for name, value in settings.items() for word in (f"--{name}", value)]
    style = ["--style", f"selection={picture}", *options]
    stylize = ["stylize", folder / "scene", "-o", folder / "new", *style]
    return [*_selected(folder, up), stylize, ["export", folder / "new", folder / "out.ply"]]


def recolor_commands(folder: Path, up: str, settings: dict[str, object]) -> list[list[object]]:
    """The same for other colours."""
    options = [
        f"--{name}={each}"
        for name, value in settings.items()
        for each in (value if isinstance(value, list) else [value])
    ]
    recolor = ["recolor", folder / "scene", "--object", "selection", "-o", folder / "new", *options]
    return [*_selected(folder, up), recolor, ["export", folder / "new", folder / "out.ply"]]


def mesh_commands(folder: Path, up: str, faces: int, texture_size: int) -> list[list[object]]:
    """To mesh.obj, with its material and texture."""
    sizes = ["--faces", faces, "--texture-size", texture_size]
    export = ["export", folder / "scene", folder / "mesh.obj", "--mesh", "--object", "selection"]
    return [*_selected(folder, up), export + sizes]


def _selected(folder: Path, up: str) -> list[list[object]]:
    scene = folder / "scene"
    return [
        ["import", folder / "in.ply", "-o", scene, f"--up={up}"],
        ["select", scene, "--name", "selection", "--rows", folder / "rows.npy"],
    ]
