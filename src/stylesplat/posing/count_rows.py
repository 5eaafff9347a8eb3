"""Says on stdout how many rows a database has, until stdin ends: `python count_rows.py FILE QUERY`.

A process of its own, since COLMAP brings its own SQLite: two copies of that in one process undo
each other's locks (sqlite.org/howtocorrupt.html, 2.2.1), and a bus error may end it.
"""

import sqlite3
import sys
import threading
from contextlib import closing
from pathlib import Path

INTERVAL = 0.2  # seconds between two looks into the database


def main() -> None:
    """Count, again and again, and once more at the end."""
    ended = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait, daemon=True).start()
    file, query = sys.argv[1:]
    uri = f"{Path(file).absolute().as_uri()}?mode=ro"
    with closing(sqlite3.connect(uri, uri=True, timeout=60.0)) as database:
        while not ended.wait(INTERVAL):
            print(database.execute(query).fetchone()[0], flush=True)
        print(database.execute(query).fetchone()[0], flush=True)


if __name__ == "__main__":
    main()
