"""What nobody has caught ends in one line too, if anything can be done about it."""

import errno
import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import torch

from processes import complaint
from stylesplat.cli import main
from stylesplat.cli.objects import Objects
from stylesplat.cli.results import BUG, OUT_OF_MEMORY
from stylesplat.cli.train import Train


def failing(error: Exception):
    def fail(*_: object) -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    ("fail", "expected"),
    [
        (lambda: np.empty(2**58, np.uint8), OUT_OF_MEMORY),
        (lambda: torch.empty(2**58, dtype=torch.uint8), OUT_OF_MEMORY),
        (failing(torch.OutOfMemoryError("CUDA out of memory. Tried to ...")), OUT_OF_MEMORY),
        (failing(OSError(errno.ENOSPC, "No space", "a")), "Disk full: a. Free some space"),
        (failing(PermissionError(errno.EACCES, "Not allowed", "a")), "Not allowed: a. Mend"),
        (failing(OSError("image file is truncated\nmore")), "image file is truncated. Mend"),
    ],
)
def test_one_line(fail, expected: str, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr(Objects, "run", lambda _: fail())
    assert expected in complaint(capsys, "objects", "x")


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Objects, "run", failing(ValueError("what")))
    with pytest.raises(ValueError) as caught:
        main(["objects", "x"])
    assert caught.value.__notes__ == [BUG]


def test_who_restarts_is_told_how_to_go_on_instead(tmp_path: Path):
    command = Train(tmp_path, tmp_path / "out", restart=True)
    assert "Every file" in command.after_interruption
    (tmp_path / "out.partial").mkdir()
    (tmp_path / "out.partial" / "checkpoint_lift.pt").touch()
    assert command.after_interruption.startswith("Without `--restart`")
    assert "`--finish`" in command.after_interruption


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_results_that_nobody_takes(scene: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    def ends(stdout: int) -> int:
        status = -1
        with suppress(OSError), os.fdopen(stdout, "w") as closed:  # raised once more at the end
            monkeypatch.setattr("sys.stdout", closed)
            status = main(["export", str(scene), str(scene / "x.splat"), "--json", "--overwrite"])
        return status

    reader, writer = os.pipe()
    os.close(reader)
    assert ends(writer) == 141, "as `stylesplat ... | head` may"
    assert ends(os.open("/dev/full", os.O_WRONLY)) == 1
    assert capsys.readouterr().err == "stylesplat: Disk full. Free some space and try again.\n"
