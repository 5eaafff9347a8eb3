"""The one exception that users are meant to read."""


class StyleSplatError(Exception):
    """Something the user can fix.

    The message is one line: the call, the fact, the remedy. The command line prints it
    without a traceback and exits with status 1.
    """
