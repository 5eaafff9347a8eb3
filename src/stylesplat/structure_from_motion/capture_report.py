"""All that a capture check finds."""

from dataclasses import dataclass
from typing import Any

from stylesplat.scene.frames import Frame
from stylesplat.scene.one_line import one_line
from stylesplat.structure_from_motion.coverage import Coverage
from stylesplat.structure_from_motion.findings import Finding


@dataclass(frozen=True)
class CaptureReport:
    """What `check` found."""

    findings: tuple[Finding, ...]
    """One a line: what, verdict, number, what it says and what to do."""
    blurred: tuple[str, ...]
    """Photos that are much less sharp than their neighbours."""
    weak: tuple[str, ...]
    """Photos that few points connect with the others."""
    coverage: Coverage
    """From where what is in the middle is shown."""
    frame: Frame
    """Where up is -y, the content is in the middle and the cameras' median distance is 1."""

    def __repr__(self) -> str:
        return one_line(self, *(f"{each.what}: {each.verdict}" for each in self.findings))

    def summary(self) -> dict[str, Any]:
        """The same as plain values, for JSON."""
        lines = {
            each.what: {
                "verdict": each.verdict,
                "number": each.number,
                "says": each.says,
                "advice": each.advice,
            }
            for each in self.findings
        }
        return {"findings": lines, "blurred": list(self.blurred), "weak": list(self.weak)}
