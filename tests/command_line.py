"""Calls of the command line, in the tests' own process."""

import json

import pytest

from stylesplat.cli import main

QUICK = ("--features", "compact", "--quality", "draft", "--device", "cpu")


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def result(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    """What a call that succeeds prints as JSON."""
    assert run(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def complaint(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that a call says whose input is at fault."""
    assert run(*arguments) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[-1].startswith("stylesplat: ")
    assert not any("Traceback" in line for line in lines)
    return lines[-1]
