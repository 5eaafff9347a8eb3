"""What is printed for people: words, numbers on request, and nothing of either with --json."""

from dataclasses import dataclass

from stylesplat.cli.telling import told


@dataclass(frozen=True)
class Bake:
    """A command that has words."""

    verbose: bool = False

    def words(self, result):
        """Two lines."""
        return iter([f"{result['loaves']} loaves.", "Next: eat"])


def test_words_come_instead_of_numbers():
    assert told(Bake(), {"loaves": 2}) == ["2 loaves.", "Next: eat"]


def test_verbose_has_both():
    lines = told(Bake(verbose=True), {"loaves": 2, "seconds": {"oven": 1.23456}})
    assert lines == ["2 loaves.", "Next: eat", "loaves: 2", "seconds:", "  oven: 1.235"]


def test_commands_without_words_print_their_numbers():
    assert told(object(), {"loaves": [{"weight": 1, "holes": []}]}) == ["loaves:", "  weight 1"]
