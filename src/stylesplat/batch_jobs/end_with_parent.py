"""Runs a command that gets SIGTERM when its parent dies: `python FILE PARENT COMMAND`, on Linux.

It becomes the command. What Python would call between fork and exec is not safe beside threads.
"""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1  # of Linux's <sys/prctl.h>: what a process gets when its parent dies


def main() -> None:
    """Ask for the signal, and become the command unless the parent is dead already."""
    parent, *command = sys.argv[1:]
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))
    if os.getppid() == int(parent):
        os.execv(command[0], command)


if __name__ == "__main__":
    main()
