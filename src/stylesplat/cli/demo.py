"""`stylesplat demo`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from stylesplat.cli.options import CONTINUES, MakingCommand, Output
from stylesplat.cli.results import mask_command, next_lines
from stylesplat.io.atomic import changing


@dataclass(frozen=True)
class Demo(MakingCommand):
    """Train a still life, repaint two of its objects, and write a report.

    Example: stylesplat demo -o demo
    """

    output: Output = Path("stylesplat-demo")
    """Folder for everything that is made."""
    after_interruption: ClassVar[str] = CONTINUES

    def run(self) -> dict[str, Any]:
        from stylesplat.demo.demo_run import run_demo

        with changing(self.output):
            return run_demo(self.output, overwrite=self.overwrite)

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        yield f"Report: {result['report']}"
        yield f"Splat: {result['splat']}, which SuperSplat, Blender and other programs open."
        yield f"Page: {result['page']}, which shows the splat in any browser, before and after."
        yield f"Video: {result['video']}"
        yield f"It took {result['seconds']} s."
        yield from next_lines(mask_command(Path("MyPhotos")))
