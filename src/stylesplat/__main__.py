"""The process of the command line: whatever happens, signals end it in one line.

They are taken before anything is loaded that takes long.
"""

import gc
import sys

from stylesplat.signals import ignore_signals, take_signals, told


def main() -> int:
    """Run one verb, and let nothing interrupt Python's own end; see `cli.main`."""
    try:
        try:
            take_signals()
            from stylesplat.__main__ import main as run

            return run()
        finally:
            ignore_signals()
            gc.freeze()  # else Python looks for garbage in all modules once more: half a second
    except KeyboardInterrupt as error:
        return told(error)


if __name__ == "__main__":
    sys.exit(main())
