"""The process that counts what COLMAP has put into its database."""

import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

from stylesplat.posing import count_rows


def test_rows_are_counted_until_stdin_ends(tmp_path: Path):
    file = tmp_path / "a #name.db"
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("CREATE TABLE photos (id)")
        database.execute("INSERT INTO photos VALUES (1), (2)")
        database.commit()
        with subprocess.Popen(
            [sys.executable, count_rows.__file__, str(file), "SELECT count(*) FROM photos"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            encoding="utf-8",
        ) as counter:
            assert counter.stdout is not None and counter.stdin is not None
            first = counter.stdout.readline()
            database.execute("INSERT INTO photos VALUES (3)")
            database.commit()
            counter.stdin.close()
            rest = counter.stdout.read().split()
    assert first == "2\n"
    assert rest[-1] == "3"
    assert counter.returncode == 0
