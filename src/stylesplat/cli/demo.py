"""`stylesplat demo` and `doctor`: what an installation can do, and whether it works."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from stylesplat.cli.command import (
    CONTINUES,
    Answer,
    Command,
    Device,
    MakingCommand,
    Output,
    mask_command,
)
from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.io.atomic import locked_folder

COLUMNS = {  # of the table: what the result calls them
    "train, steps/s": "steps_per_second",
    "PSNR, dB": "psnr",
    "render, ms": "render_ms",
    "as reference, dB": "agreement",
    "paint, s": "seconds_by_object",
    "NNFM before": "nnfm_before",
    "after": "nnfm_after",
    "all, s": "seconds",
}


@dataclass(frozen=True)
class Demo(MakingCommand):
    """Train a still life, repaint two of its objects, and write a report.

    Example: stylesplat demo -o demo
    """

    output: Output = Path("stylesplat-demo")
    """Folder for everything that is made."""
    after_interruption: ClassVar[str] = CONTINUES

    def run(self) -> Answer:
        from stylesplat.demo.demo_run import PAINTINGS_FOLDER, STYLED, run_demo

        with locked_folder(self.output):
            made = run_demo(self.output, overwrite=self.overwrite)
        styles = ("--styles", self.output / PAINTINGS_FOLDER)
        studio = shell_command("studio", self.output / STYLED, *styles)
        lines = [
            f"Report: {made['report']}",
            f"Splat: {made['splat']}, which SuperSplat, Blender and other programs open.",
            f"Page: {made['page']}, which shows the splat in any browser, before and after.",
            f"Video: {made['video']}",
            f"It took {made['seconds']} s.",
        ]
        return Answer(made, lines, [studio, mask_command(Path("MyPhotos"))])


@dataclass(frozen=True)
class Doctor(Command):
    """Say what this machine has, and test rendering, training and painting on each device.

    The table and the JSON are for reports of problems: paste them whole.

    Example: stylesplat doctor --json
    """

    device: Device = "auto"
    """What to test; auto tests the CPU and every GPU."""

    def run(self) -> Answer:
        from stylesplat.demo.doctor import doctor
        from stylesplat.io.json_yaml import strict_json

        found = doctor(self.device)
        return Answer(found, [*_tables(found), "```json", strict_json(found), "```"])

    def after_answer(self, values: dict[str, Any]) -> None:
        if values["problems"]:
            raise StyleSplatError(f"Something is wrong. {'; '.join(values['problems'])}.")


def _tables(found: dict[str, Any]) -> Iterator[str]:
    system, versions = found["system"], found["versions"]
    for name in ("stylesplat", "python", "torch", "nvrtc", "numba", "gsplat"):
        yield f"{name:11} {versions[name] or 'not installed'}"
    yield f"{'processor':11} {system['processor']}, {system['threads']} threads"
    yield f"{'memory':11} {system['memory_gib']} GiB"
    for name, gpu in found["gpus"].items():
        yield f"{name:11} {gpu['name']}, {gpu['memory_gib']} GiB"
    if found["unused_gpu"]:
        yield f"{'GPU':11} not used: {found['unused_gpu']}"
    yield f"{'device':8}{'  '.join(COLUMNS)}"
    for row in found["self_test"]:
        cells = [f"{row.get(key, '-'):>{len(title)}}" for title, key in COLUMNS.items()]
        yield f"{row['device']:8}{'  '.join(cells)}"
