import pytest

from stylesplat.errors import StyleSplatError


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("No file é.ply. Give another.", "No file é.ply. Give another."),
        ("two\nlines\r\nand a tab\t.", "two lines and a tab ."),
        ("No file 9.41\u202fAM.png.", "No file 9.41\u202fAM.png."),
        ("\x1b[31mred\x00 \ud800", "[31mred"),
    ],
)
def test_a_message_is_one_line_that_a_terminal_can_show(message: str, shown: str):
    assert str(StyleSplatError(message)) == shown


def test_a_message_keeps_what_it_begins_and_ends_with():
    line = str(StyleSplatError(f"No object {'x' * 100_000}. Select it."))
    assert line.startswith("No object xxx")
    assert line.endswith("x. Select it.")
    assert len(line) < 2000
