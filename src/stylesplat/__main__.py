"""The process of the command line. It takes signals before it loads anything that takes long."""

import gc
import sys

from stylesplat.signals import ignore_signals, report_interruption, take_signals


def main() -> int:
    """Run one verb, and ignore signals while Python shuts down; see `cli.main`."""
    try:
        try:
            take_signals()
            from stylesplat.cli import main as run

            return run()
        finally:
            ignore_signals()
            gc.freeze()  # else Python looks for garbage in all modules once more: half a second
    except KeyboardInterrupt as error:
        return report_interruption(error)


if __name__ == "__main__":
    sys.exit(main())
