"""Commands in messages, as a shell takes them."""

import shlex


def pasted(verb: str, *arguments: object) -> str:
    """A command that can be pasted, whatever the names and places in it hold."""
    return shlex.join(["stylesplat", verb, *map(str, arguments)])
