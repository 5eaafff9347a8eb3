"""`stylesplat demo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from stylesplat.cli.options import CONTINUES, Json, Output, Overwrite


@dataclass(frozen=True)
class Demo:
    """Make a still life, train it, repaint two of its objects and write a report.

    Example: stylesplat demo -o demo
    """

    first: ClassVar = ("output",)
    output: Output = Path("stylesplat-demo")
    """Folder for everything that is made."""
    overwrite: Overwrite = False
    json: Json = False
    after_interruption: ClassVar[str] = CONTINUES

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.demo.demo_run import run_demo
        from stylesplat.io.recovery import changing

        with changing(self.output):
            return run_demo(self.output, overwrite=self.overwrite)
