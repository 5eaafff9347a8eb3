"""Plain files and JSON."""

import math
import os
from pathlib import Path
from string import ascii_lowercase, digits

import numpy as np
import pytest
import torch

from processes import needs_pipes
from stylesplat.errors import StyleSplatError
from stylesplat.io.files import file_stem, read_bytes
from stylesplat.io.json_yaml import read_json, write_json


def test_json_is_strict(tmp_path: Path):
    content = {"text": "ä", "list": [1, 0.1, None], "nested": {"yes": True}}
    odd = {"psnr": float("inf"), "numbers": (float("nan"),), "path": Path("a/b")}
    arrays = [torch.tensor(-math.inf), np.float32(math.nan), np.array(1.5), np.int64(3)]
    write_json(content | odd | {"arrays": arrays}, tmp_path / "a.json")
    found = content | {"psnr": None, "numbers": [None], "path": "a/b"}
    assert read_json(tmp_path / "a.json") == found | {"arrays": [None, None, 1.5, 3]}


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (None, "No such file"),
        ("{", "not valid JSON"),
        ('{"a":' * 200 + "1" + "}" * 200, "nested more than 100 deep"),
    ],
)
def test_bad_json(tmp_path: Path, text: str | None, match: str):
    if text is not None:
        (tmp_path / "a.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(StyleSplatError, match=rf"Cannot read .*a\.json: .*{match}"):
        read_json(tmp_path / "a.json")


def test_file_stems_are_safe_and_differ():
    names = ["vase", "Vase", "VASE", "a/b", "a\\b", "a-b", "..", "", "\u00e9", "e\u0301"]
    names += ["x" * 48, "x" * 99]
    stems = [file_stem(name) for name in names]
    assert len({stem.lower() for stem in stems}) == len(names)
    assert stems[0] == "vase" and stems[5] == "a-b"
    for stem in stems:
        assert len(stem) < 80 and set(stem) <= set(ascii_lowercase + digits + "_-~")
        again = file_stem(stem)
        assert again == stem or again not in stems, "a name cannot be another's stem"


@needs_pipes
def test_only_plain_files_are_read(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    for name, fault in (
        ("pipe", "no plain file"),
        ("", "it is a folder"),
        ("lost", "No such file"),
        ("a" * 300, "name too long"),
        ("a\0b", "cannot be the name of a file"),
    ):
        with pytest.raises(StyleSplatError, match=fault):
            read_bytes(tmp_path / name)
