"""The process of the command line. It catches signals before it loads anything that takes long."""

import gc
import sys

from stylesplat.interrupts import (
    catch_signals,
    ignore_signals,
    raise_if_interrupted,
    report_interruption,
)


def main() -> int:
    """Run one verb, and ignore signals while Python shuts down; see `cli.main`."""
    try:
        try:
            catch_signals()
            # By default Python looks for garbage 600 times while torch is loaded: 0.4 of 4.5 s.
            # Training and painting leave no tensors in cycles, so that nothing large waits for it
            gc.set_threshold(50_000)
            from stylesplat.cli import main as run

            raise_if_interrupted()
            return run()
        finally:
            ignore_signals()
            gc.freeze()  # else Python looks for garbage in all modules once more: half a second
    except KeyboardInterrupt as error:
        return report_interruption(error)


if __name__ == "__main__":
    sys.exit(main())
