"""A process that reads mutants and tells how each ended; run by `trials.py`.

Called with a folder to work in and a limit of memory in bytes. Every line of its input names a
reader, the first seed and the number of mutants. Standard output is for the answers, a line of JSON
each; what libraries print there goes to standard error.
"""

import json
import os
import re
import resource
import shutil
import sys
import time
import warnings
from pathlib import Path

import stylesplat  # noqa: F401  (first: it sets up threading before torch loads)

import torch  # isort: skip

from mutants import mutant
from readers import READERS, Reader
from stylesplat.errors import StyleSplatError

LONGEST = 2000  # characters of a line that somebody is to read
UNLIMITED = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
NO_MEMORY = re.compile(
    "not enough memory|unable to allocate|bad_alloc|out of memory", re.IGNORECASE
)


class Bench:
    """A reader with its valid files on disk."""

    def __init__(self, name: str, root: Path) -> None:
        self.reader: Reader = READERS[name]
        self.root = root / name  # what is beside its folders must stay as it is
        self.folder = self.root / "given" / "input"
        self.out = self.root / "written" / "output"
        self.reader.make(self.folder)
        found = {p for each in self.reader.files for p in self.folder.glob(each) if p.is_file()}
        self.files = {path: path.read_bytes() for path in sorted(found)}
        fault = self.fault()
        assert fault is None, f"{name} cannot read what it is to make mutants of: {fault}"

    def file(self, seed: int) -> Path:
        return [*self.files][seed % len(self.files)]

    def trial(self, seed: int) -> tuple[str, str]:
        """How it ends with a mutant, and what it said."""
        path = self.file(seed)
        content = self.files[path]
        path.write_bytes(mutant(path.name, content, seed))
        before = self.beside()
        fault = self.fault()
        escaped = self.beside() != before
        path.write_bytes(content)
        if escaped:
            return "escaped", "something was written elsewhere"
        return fault or ("fine", "")

    def fault(self) -> tuple[str, str] | None:
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir(parents=True)
        try:
            self.reader.use(self.folder, self.out)
        except StyleSplatError as error:
            return refusal(str(error))
        except MemoryError as error:
            return "memory", repr(error)
        except Exception as error:
            kind = "memory" if NO_MEMORY.search(str(error)) else "traceback"
            return kind, f"{place(error)} {type(error).__name__}: {str(error)[:200]}"
        return None

    def beside(self) -> list[tuple[str, int]]:
        """All files but the results."""
        found = self.root.rglob("*")
        ours = [path for path in found if not path.is_relative_to(self.out) and path.is_file()]
        return sorted((str(path), path.stat().st_mtime_ns) for path in ours)


def refusal(message: str) -> tuple[str, str]:
    """A message that is one line, or what is wrong with it."""
    if not message.isprintable() or len(message) > LONGEST:
        return "garbled", repr(message[:300])
    return "refused", message


def place(error: BaseException) -> str:
    """The last line of our own that an error went through."""
    found, trace = "?", error.__traceback__
    while trace is not None:
        path = Path(trace.tb_frame.f_code.co_filename)
        if "stylesplat" in path.parts:
            found = f"{path.name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return found


def limit_memory(more: int) -> None:
    """Allow so many bytes of address space beyond what is taken."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + more, resource.RLIM_INFINITY))


def main(root: Path, more: int) -> None:
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    benches: dict[str, Bench] = {}
    for line in sys.stdin:
        name, first, count = json.loads(line)
        if name not in benches:
            resource.setrlimit(resource.RLIMIT_AS, UNLIMITED)
            benches[name] = Bench(name, root / str(os.getpid()))
        limit_memory(more)
        for seed in range(first, first + count):
            start = time.perf_counter()
            file = benches[name].file(seed).name
            outcome, told = benches[name].trial(seed)
            seconds = time.perf_counter() - start
            print(json.dumps([seed, file, outcome, told, seconds]), file=answers)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
