"""`stylesplat demo`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from stylesplat.cli.next_steps import next_lines
from stylesplat.cli.options import CONTINUES, Json, Output, Overwrite, Verbose
from stylesplat.scene.arguments import pasted


@dataclass(frozen=True)
class Demo:
    """Train a still life, repaint two of its objects, and write a report.

    Example: stylesplat demo -o demo
    """

    first: ClassVar = ("output",)
    output: Output = Path("stylesplat-demo")
    """Folder for everything that is made."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False
    after_interruption: ClassVar[str] = CONTINUES

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.demo.demo_run import run_demo
        from stylesplat.io.atomic import changing

        with changing(self.output):
            return run_demo(self.output, overwrite=self.overwrite)

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        yield f"Report: {result['report']}"
        yield f"Splat: {result['splat']}, which SuperSplat, Blender and other programs open."
        yield f"Page: {result['page']}, which shows the splat in any browser, before and after."
        yield f"Video: {result['video']}"
        yield f"It took {result['seconds']} s."
        own = [pasted("mask", "MyPhotos", "--box", "NAME=PHOTO:x0,y0,x1,y1")]
        yield from next_lines(*own)
