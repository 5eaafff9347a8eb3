"""Lines that are said once, however often something asks for it."""


class Once:
    """The part of an observer that says lines; how they are written differs."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def say(self, line: str) -> None:
        """Write a line, if it was not written before."""
        if line not in self._said:
            self._said.add(line)
            self._write(line)

    def _write(self, line: str) -> None:
        raise NotImplementedError
