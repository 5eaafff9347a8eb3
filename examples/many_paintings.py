"""Paint one object of several scenes in several pictures, each in a process of its own.

python examples/many_paintings.py vase results garden desk -- wave.jpg night.jpg

The same command goes on where it stopped; a picture that is added costs only its own paintings.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import stylesplat as ss


def main(
    name: str, output: str, scenes: Sequence[str], pictures: Sequence[str], **settings: Any
) -> None:
    """Write `output`/jobs.yaml and the results, and say how each job ended."""
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    absolute = [str(Path(each).absolute()) for each in pictures]
    paint = {"style": {name: absolute}, "quality": "draft"}  # lists multiply
    job = {"stylize": {**paint, **settings}}
    jobs = {"scenes": [str(Path(each).absolute()) for each in scenes], "jobs": [job]}
    (folder / "jobs.yaml").write_text(json.dumps(jobs, indent=2))  # JSON is YAML, too
    done = ss.batch(folder / "jobs.yaml", folder / "results")
    for each in done.of("done"):
        print(f"{each.job}: {each.seconds:.0f} s")
    for each in done.of("failed"):
        print(f"{each.job}: {each.reason}")


if __name__ == "__main__":
    split = sys.argv.index("--")
    main(sys.argv[1], sys.argv[2], sys.argv[3:split], sys.argv[split + 1 :])
